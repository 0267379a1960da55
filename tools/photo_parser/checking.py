"""Hold the photo parser against masks that were drawn by hand over photos; figures and a sheet to look at."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from grmm_core.fitting.track import track_photos
from grmm_core.fitting.types import PhotoTrack, load_tracks, save_tracks
from grmm_core.head import HeadModel
from grmm_core.photo.parser import LABELS, PhotoParts, parse

GROUPS = {
    "background": ("background",), "face": ("skin", "brows", "beard", "eyes", "lips", "mouth", "ears"), "neck": ("neck",),
    "hair": ("hair",), "clothes": ("clothes",), "hat": ("hat",), "glasses": ("glasses",), "other": ("other",),
}  # fmt: skip
"""What the drawn masks tell apart."""
WORN = {"beard": 0.003, "glasses": 0.003, "hat": 0.02}
"""And from which share of the person's pixels on it is seen."""
COLORS = np.array([
    (40, 40, 60), (230, 180, 150), (90, 50, 20), (0, 0, 0), (150, 80, 0), (255, 255, 255), (220, 40, 60), (255, 120, 200),
    (0, 255, 255), (160, 0, 200), (255, 220, 0), (180, 140, 110), (30, 90, 220), (0, 200, 60),
], np.uint8)  # fmt: skip


def compare(photos: list[Path], drawn: Path, tracks: Path, head: HeadModel, sheet: Path) -> dict[str, dict[str, float]]:
    """Intersection over union of each group in each photo.

    Args:
        photos: Files; those that have no drawn masks are left aside.
        drawn: JSON: "HASH#FACE" (16 digits of the file's SHA-256) to a list of [group, [[x, y], ...]] in the photo's pixels,
            painted in this order.
        tracks: Folder where tracked photos are kept.
        head: To track with.
        sheet: PNG to write: photo, labels, drawn masks.
    """
    result, rows = {}, []
    by_hash = {hashlib.sha256(path.read_bytes()).hexdigest()[:16]: path for path in photos}
    for key, polygons in json.loads(drawn.read_text()).items():
        digest, face = key.split("#")
        if digest not in by_hash:
            continue
        track = _tracked(by_hash[digest], int(face), tracks, head)
        parts = parse(track, head)
        wanted = painted(polygons, track)
        named = {group for group, _ in polygons}
        shares = overlaps(parts, wanted, track.valid > 0.5)
        known = named | ({"background"} if "face" in named else set())  # else the rest of the picture is not drawn
        result[f"{by_hash[digest].name}#{face}"] = {group: share for group, share in shares.items() if group in known}
        labels = np.stack([getattr(parts, label) for label in LABELS]).argmax(0)
        reference = np.array([LABELS.index(members[0]) for members in GROUPS.values()])[wanted]
        rows.append(np.concatenate([(track.image * 255).astype(np.uint8), COLORS[labels], COLORS[reference]], 1)[::2, ::2])
    rows += [0 * rows[-1]] * (len(rows) % 2)
    Image.fromarray(np.concatenate([np.concatenate(rows[0::2]), np.concatenate(rows[1::2])], 1)).save(sheet)
    return result


def worn(photos: list[Path], known: Path, tracks: Path, head: HeadModel) -> dict[str, dict[str, int]]:
    """In how many photos beards, glasses and hats are found, missed, and seen where there are none.

    Args:
        photos: Files; those that are not known are left aside.
        known: JSON: "HASH#FACE" to {"worn": [...], "perhaps": [...]}, the latter for stubble, which does not count.
        tracks: Folder where tracked photos are kept.
        head: To track with.
    """
    entries = json.loads(known.read_text())
    counts = {name: dict.fromkeys(("found", "missed", "false"), 0) for name in WORN}
    for path in photos:
        key = hashlib.sha256(path.read_bytes()).hexdigest()[:16] + "#0"
        if key not in entries:
            continue
        parts = parse(_tracked(path, 0, tracks, head), head)
        person = float((1.0 - parts.background).sum())
        for name, least in WORN.items():
            seen = float((getattr(parts, name) > 0.5).sum()) > least * person
            if name in entries[key]["worn"]:
                counts[name]["found" if seen else "missed"] += 1
            elif name not in entries[key].get("perhaps", ()):
                counts[name]["false"] += seen
    return counts


def _tracked(path: Path, face: int, tracks: Path, head: HeadModel) -> PhotoTrack:
    """A photo as it was tracked before, or is now."""
    tracks.mkdir(parents=True, exist_ok=True)
    kept = tracks / f"{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}_{face}.safetensors"
    if not kept.exists():
        save_tracks(kept, track_photos([path], head, faces=[face]))
    return load_tracks(kept)[0]


def painted(polygons: list[tuple[str, list[list[int]]]], track: PhotoTrack) -> np.ndarray:
    """Number of the group that was drawn at each pixel of the working picture, [H, W]."""
    camera, whole = track.camera, track.photo_camera
    picture = Image.new("L", (camera.width, camera.height), 0)
    scale, names = camera.fx / whole.fx, list(GROUPS)
    for group, points in polygons:
        moved = [((x - whole.cx) * scale + camera.cx, (y - whole.cy) * scale + camera.cy) for x, y in points]
        ImageDraw.Draw(picture).polygon(moved, fill=names.index(group))
    return np.asarray(picture)


def overlaps(parts: PhotoParts, wanted: np.ndarray, valid: np.ndarray) -> dict[str, float]:
    """Intersection over union of each group that was drawn."""
    found = np.stack([np.sum([getattr(parts, label) for label in members], 0) for members in GROUPS.values()]).argmax(0)
    shares = {}
    for number, group in enumerate(GROUPS):
        a, b = (found == number) & valid, (wanted == number) & valid
        if b.any():
            shares[group] = float((a & b).sum() / (a | b).sum())
    return shares
