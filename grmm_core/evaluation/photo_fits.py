"""How good fits are: real photos with sheets to look at, and what the stages do to synthetic people whose truth is known.

``evaluate_photo``    a photo, fitted as users do: errors in its view, a sheet
``compare_stages``    stage 2 off, on, and on without locality: the input view against other views and other expressions

Called by the command line (`grmm evaluate --protocol monocular` on a folder of photos) and by whoever measures. Imports torch.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..avatar import Avatar
from ..controls.frame import Controls
from ..errors import GrmmError
from ..fitting.api import fit
from ..fitting.hair_view import hair_view
from ..fitting.invert import invert, photo_pictures
from ..fitting.photo_light import MATT
from ..fitting.presets import Preset
from ..fitting.request import FitRequest
from ..fitting.result import photo_controls, photo_light
from ..fitting.types import LANDMARK_COUNT, PhotoTrack
from ..geometry.camera import Camera
from ..hair.coloring import around_head
from ..head import HeadModel
from ..jobs.progress import Progress, Share, nobody
from ..light.lamps import Lighting
from ..model.grmm import GRMM
from ..model.portrait import portrait_camera
from ..model.torch_loader import with_deltas
from ..photo.faces import landmarks_near, to_pixels
from ..photo.landmarks import EYE_CORNERS
from ..photo.parser import parse
from ..pictures.images import write_png
from ..session import HairUse, Instance, RenderOptions, Session, create_session
from .cleanliness import FROM_FRONT, SHEET, Shot, cleanliness, seam, seen_vertices
from .evenness import evenness
from .haired import turned_degrees
from .identity import Identity, photo_landmarks
from .metrics import Distance, errors_of
from .person_fit import exact_track
from .report import sheet
from .samples import Sample, load
from .scene import DrawnPerson, Scene

STAGES: dict[str, dict[str, Any]] = {
    "stage 1": {"second_stage": False},
    "stage 2": {},
    "stage 2 without locality": {"locality": 0.0},
}
SHEET_PIXELS = 320
MEASURED_PIXELS = 512
_GREY = 0.5
_FULL, _LEAST_HAIR = 0.9, 0.01  # of a pixel, from where on it is hair; of the picture around the head: less hair tells nothing


def evaluate_photo(
    photo: Path, scene: Scene, weights: str | Path | None, out: Path, preset: str = "standard", *, device: str = "auto",
    threads: int = 0, distances: Mapping[str, Distance] | None = None, identity: Identity | None = None, report: Share = nobody,
) -> dict[str, Any]:  # fmt: skip
    """Fit one photo without hand work, measure it in its own view, and write avatar and sheet.

    Args:
        photo: Of a person who agreed.
        scene: Model of the weights.
        weights: Name of installed weights, or a file; None for the embedded ones.
        out: Folder for NAME.grmm and NAME.png.
        preset: Of the fit.
        device: Where the model runs.
        threads: CPU threads; 0 leaves it to the libraries.
        distances: Perceptual networks by name.
        identity: A face-recognition network (`identity.load_identity`), or None.
        report: Hears how much is done.

    Returns:
        Figures of the photo and of `photo_sheet`, or the sentence why there is no avatar.
    """

    def show(progress: Progress) -> None:
        report(progress.fraction, photo.name)

    request = FitRequest(
        (photo,), out / f"{photo.stem}.grmm", preset, weights="" if weights is None else str(weights), device=device,
        threads=threads,
    )  # fmt: skip
    try:
        result = fit(request, progress=show)
    except GrmmError as error:
        return {"error": str(error)}
    model = with_deltas(scene.model, result.avatar.deltas, result.path)
    with create_session("local", weights=weights, device=device, threads=threads or None) as session:
        worn = Worn(session, result.path, result.avatar, scene.head)
        figures = photo_figures(model, result.avatar, result.tracks, distances, identity, worn)
        figures |= drawn_landmarks(result.tracks[0], worn) | hair_figures(result.tracks[0], worn)
        figures |= {} if identity is None else likeness(result.tracks[0], worn, identity)
        page, clean = photo_sheet(model, result.avatar, result.tracks[0], worn)
    write_png(out / f"{photo.stem}.png", page)
    return {**figures, **clean, "seconds": round(result.seconds, 1)}


def photos_result(rows: Mapping[str, dict[str, Any]], preset: str) -> dict[str, Any]:
    """Figures of each photo by file name, and their means."""
    fitted = [row for row in rows.values() if "error" not in row]
    names = sorted({name for row in fitted for name, value in row.items() if isinstance(value, float)})
    means = {name: float(np.mean([row[name] for row in fitted if name in row])) for name in names}
    return {"preset": preset, "photos": dict(rows), "mean": means, "fitted": len(fitted)}


def photos_table(result: Mapping[str, Any]) -> str:
    """The figures of `photos_result` as Markdown."""
    shown = ["rmse", "psnr", "ssim", "landmark_error", "landmarks_drawn"]
    shown += ["identity", "identity_rest", "identity_30", "identity_60"]
    names = [name for name in shown if name in result["mean"]]
    names += [name for name in result["mean"] if name not in (*names, "seconds")]
    lines = ["| photo | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for photo, row in (*result["photos"].items(), ("mean", result["mean"])):
        cells = [row["error"]] if "error" in row else [f"{row[name]:.3f}" if name in row else "" for name in names]
        lines.append(f"| {photo} | " + " | ".join(cells + [""] * (len(names) - len(cells))) + " |")
    heading = f"Preset {result['preset']}, {result['fitted']} of {len(result['photos'])} photos fitted"
    return "\n".join([heading, "", *lines, ""])


class Worn:
    """A fitted avatar as a session draws it, with its strands.

    Args:
        session: With the weights of the avatar.
        path: Of its file.
        avatar: What is in it.
        head: Its head model.
    """

    def __init__(self, session: Session, path: Path, avatar: Avatar, head: HeadModel) -> None:
        self._session, self._id = session, session.open(path).id
        self._avatar, self.head = avatar, head

    def shot(self, controls: Controls, camera: Camera, lighting: Lighting | None = None, hair: HairUse | None = None) -> Shot:
        """One picture over grey, in the studio's light or that of a photo, with its own hair or as `hair` says."""
        options = RenderOptions(passes=("rgb", "alpha", "hair"), background=(_GREY,) * 3, lighting=lighting)
        drawn = self._session.render([Instance(self._id, controls, response=MATT, hair=hair or HairUse())], camera, options)
        vertices = np.asarray(self._session.deform(self._id, controls).vertices, np.float64)
        return Shot(vertices, camera, drawn["rgb"], drawn["alpha"][..., 0], drawn["hair"][..., 0])

    def photo(self, camera: Camera, index: int = 0, hair: HairUse | None = None) -> Shot:
        """As one of the photos shows the person, in its light."""
        light = photo_light(self._avatar, index).lighting
        return self.shot(photo_controls(self._avatar, self.head, index), camera, light, hair)


def photo_figures(
    model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack], distances: Mapping[str, Distance] | None = None,
    identity: Identity | None = None, worn: Worn | None = None,
) -> dict[str, float]:  # fmt: skip
    """Means over an avatar's photos: rmse, psnr, ssim on head and bare neck, distances of networks, landmark error.

    On weights without hair that is bare skin, eyes and mouth, and `worn` draws brows and lashes over them. `rmse_dressed` also
    has the clothes that other weights paint on neck and bust, whose texels are coarse.
    """
    figures: dict[str, list[float]] = {}
    for (view, drawn), track in zip(photo_pictures(model, avatar, tracks, MEASURED_PIXELS), tracks, strict=True):
        grey = torch.full((3,), _GREY, dtype=model.dtype, device=model.device)
        counts = view.weight[..., None]
        shown = drawn.over(grey).image
        if worn is not None and view.index == 0:
            shown = torch.as_tensor(worn.photo(view.camera).rgb).to(shown)
        shown, target = shown * counts, view.target(grey) * counts
        errors = errors_of(shown, target, view.measured, distances=distances)
        found = {"rmse": errors.rmse_mask, "psnr": errors.psnr_mask, "ssim": errors.ssim_mask, **errors.perceptual}
        found["rmse_dressed"] = errors_of(shown, target, view.inside).rmse_mask
        if identity is not None:
            marks = photo_landmarks(track, view.camera)
            both = (identity.embedding(picture, marks) for picture in (shown.clamp(0, 1), target))
            found["identity"] = identity.distance(*both)
        for name, value in {**found, "landmark_error": track.landmark_error}.items():
            figures.setdefault(name, []).append(value)
    return {name: float(np.mean(values)) for name, values in figures.items()}


def hair_figures(track: PhotoTrack, worn: Worn) -> dict[str, float]:
    """How an avatar's scalp hair is like that of its first photo, in that view and light; nothing where it hardly shows.

    `hair_overlap`: Jaccard index of the two covers. `hair_rmse`: over the photo's hair, what the avatar leaves bare included.
    `hair_turned`: degrees between the strands' directions (`haired.turned_degrees`), not where the photo has no clear one.
    """
    seen = around_head(hair_view(track, parse(track, worn.head), worn.head))
    drawn = worn.photo(seen.camera, hair=HairUse(brows="none", beard="none", lashes="none"))
    hair = seen.hair * seen.counts
    full = hair > _FULL
    if full.sum() < _LEAST_HAIR * full.size:
        return {}
    both, either = (pick(drawn.hair * seen.counts, hair).sum() for pick in (np.minimum, np.maximum))
    off = np.square(drawn.rgb - seen.image)[full].mean()
    figures = {"hair_overlap": float(both / either), "hair_rmse": float(np.sqrt(off))}
    turned = turned_degrees(drawn.rgb, seen.image, full)
    return figures if math.isnan(turned) else {**figures, "hair_turned": turned}


def drawn_landmarks(track: PhotoTrack, worn: Worn) -> dict[str, float]:
    """How far the landmark network finds an avatar's landmarks, in its first photo's view and light, from the photo's.

    `landmarks_drawn`: mean distance, as a share of that of the eyes. Other than `landmark_error`, which is about where tracking
    has put the mesh, it has none of what the network gets wrong in both pictures alike.
    """
    shot = worn.photo(track.camera)
    behind = track.image * track.mask[..., None] + _GREY * (1.0 - track.mask[..., None])
    photo, drawn = (landmarks_near(to_pixels(picture), track.landmarks)[:, :2] for picture in (behind, shot.rgb))
    right, left = (photo[corner] for corner in EYE_CORNERS)
    return {"landmarks_drawn": float(np.linalg.norm(photo - drawn, axis=1).mean() / np.linalg.norm(left - right))}


def likeness(track: PhotoTrack, worn: Worn, identity: Identity) -> dict[str, float]:
    """How far a face-recognition network finds an avatar at rest, in the studio's light, from its photo.

    `identity_rest` from the front, `identity_30` and `identity_60` turned by so many degrees, means of both sides. What people
    are known by must not be left in the light or the expression of the photo.
    """
    own = identity.embedding(torch.as_tensor(np.array(track.image)), np.asarray(track.landmarks[:, :2], np.float64))

    def off(yaw: float) -> float:
        shot = worn.shot(Controls(), portrait_camera(MEASURED_PIXELS, yaw, 0))
        _, marks = shot.camera.project(worn.head.landmark_positions(shot.vertices, LANDMARK_COUNT))
        return identity.distance(own, identity.embedding(torch.as_tensor(shot.rgb), marks))

    turned = {f"identity_{yaw}": float(np.mean([off(yaw), off(-yaw)])) for yaw in (30, 60)}
    return {"identity_rest": off(0), **turned}


def photo_sheet(
    model: GRMM, avatar: Avatar, track: PhotoTrack, worn: Worn, pixels: int = SHEET_PIXELS
) -> tuple[np.ndarray, dict[str, float]]:
    """Photo, fit, and the twelve views and expressions of `cleanliness.SHEET`, uint8; and how clean those are.

    The figures are the worst view's `outside`, `holes` and `specks`, the `seam`, and how much light there is in the photo and
    left in the studio's rig (`evenness.Evenness.spread`).
    """
    view, _ = photo_pictures(model, avatar, [track], pixels)[0]
    seen, even = worn.photo(view.camera), worn.shot(photo_controls(avatar, worn.head), view.camera)
    shots = [worn.shot(Controls().set_named(controls), portrait_camera(pixels, yaw, pitch)) for controls, yaw, pitch in SHEET]
    rows = [view.image.cpu().numpy(), seen.rgb, *(shot.rgb for shot in shots)]
    found = [cleanliness(shot, worn.head) for shot in shots]
    clean = {name: max(one[name] for one in found) for name in found[0]}
    known = seen_vertices(seen.vertices, view.camera, view.inside.cpu().numpy(), worn.head)
    lit = {"light": evenness(rows[0], even, worn.head).spread, "light_left": evenness(even.rgb, even, worn.head).spread}
    return sheet([rows[:7], rows[7:]]), {**clean, **lit, "seam": seam(shots[:FROM_FRONT], known, worn.head)}


def compare_stages(
    scene: Scene, source: Sample, others: Mapping[str, Sequence[Sample]], preset: str | Preset = "standard", size: int = 384,
    picture: Path | None = None,
) -> dict[str, dict[str, float]]:  # fmt: skip
    """Fit one captured view with exact tracking, stage by stage, and measure it and other views of the person.

    Args:
        scene: Model that was not trained on the person.
        source: View that is fitted.
        others: Groups of further views by name, such as "other views" and "other expressions".
        preset: Of the fit.
        size: Longer side of the pictures.
        picture: PNG to write: a row for the truth and one for each stage, a column for each view.

    Returns:
        PSNR inside the mask in dB for each of `STAGES`: of the input and of each group.
    """
    shape = source.dataset.shape(source.shot.subject)
    track = exact_track(scene.head, source, load(source, size), shape)
    groups = {"input": [source], **others}
    views = [sample for group in groups.values() for sample in group]
    results, rows = {}, [[_over_grey(loaded.image, loaded.mask) for loaded in (load(sample, size) for sample in views)]]
    with tempfile.TemporaryDirectory(prefix="grmm-evaluate-") as folder:  # stage 1 is done once
        for name, switches in STAGES.items():
            avatar = invert([track], scene.model, scene.head, preset, info=scene.info, work=Path(folder), **switches)
            person = scene.from_avatar(avatar)
            results[name] = {group: psnr_of_views(scene, person, samples, size) for group, samples in groups.items()}
            drawn = [scene.draw(person, sample.shot, load(sample, size).camera) for sample in views]
            rows.append([_over_grey(one.image.cpu().numpy(), one.alpha.cpu().numpy()) for one in drawn])
    if picture is not None:
        write_png(picture, sheet(rows))
    return results


def _over_grey(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return np.clip(image + (1.0 - alpha[..., None]) * _GREY, 0.0, 1.0)


def psnr_of_views(scene: Scene, person: DrawnPerson, samples: Sequence[Sample], size: int) -> float:
    """Mean PSNR inside the mask of a person in captured views, dB."""
    values = []
    for sample in samples:
        view = load(sample, size)
        image = scene.draw(person, sample.shot, view.camera).image
        errors = errors_of(image, scene.tensor(view.image), scene.tensor(view.mask))
        if math.isfinite(errors.psnr_mask):
            values.append(errors.psnr_mask)
    return float(np.mean(values)) if values else math.nan
