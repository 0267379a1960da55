"""`python -m tools.check_performance FILE --out DIR`: play a recording in Blender; see whether lips, lids and curves are right.

The recording is imported through the installed extension with calibration, smoothing and reduction, then followed through its
frames:

* the distance of the inner lips and the opening of the lids, measured on the mesh that Blender evaluates, before and after
  cleaning, as a picture and as numbers (jitter = mean size of the third difference, which movements of a face hardly reach);
* a contact sheet of frames that the GRMM engine rendered: evenly spaced ones, then those where the lips are closed and where
  the lids are.

Needs bpy and torch (`pip install -e .[studio,dev]`). Writes DIR/contact_sheet.png, DIR/curves.png, DIR/curves.csv.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

TILE, COLUMNS, CAPTION = 256, 8, 16
LIPS = (62, 66)  # iBUG's inner lips, middle; their height over one another, since one may stand before the other
LIDS = ((37, 41), (38, 40), (43, 47), (44, 46))  # upper and lower lids, both eyes
PLOT = (1200, 220)  # pixels of one curve
_COLORS = ((170, 170, 170), (200, 60, 30))


def main() -> int:
    """Play the recording, write curves, figures and pictures, and return the exit code."""
    parser = argparse.ArgumentParser(description="Play a recording in Blender, measure it, render a contact sheet.")
    parser.add_argument("recording", type=Path, help="ARKit JSON, Live Link Face CSV")
    parser.add_argument("--out", type=Path, default=Path("out/performance"))
    parser.add_argument("--neutral", default="AUTO", help="AUTO, NONE, or frames of the recording such as 0,12-15")
    parser.add_argument("--smoothing", type=float, default=0.4)
    parser.add_argument("--max-error", type=float, default=0.01, help="of reduced keys")
    parser.add_argument("--size", type=int, default=256, help="pixels of a rendered frame")
    parser.add_argument("--even", type=int, default=16, help="evenly spaced frames on the sheet, 0 for none")
    parser.add_argument("--extreme", type=int, default=8, help="frames with closed lips, and as many with closed lids")
    arguments = parser.parse_args()
    out = arguments.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    neutral = arguments.neutral.upper() if arguments.neutral.upper() in ("AUTO", "NONE") else "FRAMES"
    options = {
        "neutral": neutral, "smoothing": arguments.smoothing, "keys": "REDUCED", "max_error": arguments.max_error,
    }  # fmt: skip
    if neutral == "FRAMES":
        options["neutral_frames"] = arguments.neutral
    blender = _Blender(arguments.size)
    raw = blender.play(arguments.recording.resolve(), {"keys": "SAMPLES", "smoothing": 0.0, "neutral": "NONE"})
    clean = blender.play(arguments.recording.resolve(), options)
    _report(raw, clean, out)
    chosen = _choose(clean, arguments.even, arguments.extreme)
    pictures = [(caption, blender.render(frame, out)) for caption, frame in chosen]
    if pictures:
        _sheet(pictures, out / "contact_sheet.png")
    print(f"wrote {', '.join(str(path) for path in sorted(out.glob('c*.*')))}")
    return 0


class _Blender:
    """A Blender with the built extension, a head and a camera."""

    def __init__(self, size: int) -> None:
        from .build_extension import build

        os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="grmm-check-")
        extension = build(Path(tempfile.mkdtemp(prefix="grmm-zip-")))
        import bpy

        self.bpy = bpy
        bpy.ops.wm.read_homefile(use_empty=True)
        bpy.ops.extensions.package_install_files(filepath=str(extension), repo="user_default", enable_on_install=True)
        self.modules = {
            name: sys.modules[f"bl_ext.user_default.grmm.{name}"] for name in ("grmm_blender.rig.avatar", "grmm_core.head")
        }
        bpy.ops.grmm.add_head()
        self.avatar = self.modules["grmm_blender.rig.avatar"].avatar_of(bpy.context.object)
        scene = bpy.context.scene
        scene.render.fps = 30
        scene.render.engine = "GRMM"
        scene.render.resolution_x = scene.render.resolution_y = size
        scene.view_settings.view_transform = "Standard"
        scene.world = bpy.data.worlds.new("Backdrop")
        scene.world.color = (0.7, 0.7, 0.7)
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        camera.location, camera.rotation_euler = (0.0, -0.75, -0.02), (np.pi / 2, 0.0, 0.0)
        camera.data.lens = 85.0
        scene.camera = camera

    def play(self, recording: Path, options: dict[str, Any]) -> dict[str, Any]:
        """Import and measure every frame. Returns lip distance [T] and lid opening [T] in millimetres, and the keys' number."""
        bpy, scene = self.bpy, self.bpy.context.scene
        for owner in (self.avatar.object, self.avatar.armature):
            if owner.animation_data is not None:
                owner.animation_data.action = None  # `animation_data_clear` would take the drivers too
        bpy.ops.grmm.import_performance(filepath=str(recording), start=1, **options)
        head = self.modules["grmm_core.head"].load_open_head()
        lips, lids = [], []
        for frame in range(scene.frame_start, scene.frame_end + 1):
            scene.frame_set(frame)
            evaluated = self.avatar.object.evaluated_get(bpy.context.evaluated_depsgraph_get())
            points = np.empty(len(evaluated.data.vertices) * 3, np.float32)
            evaluated.data.attributes["position"].data.foreach_get("vector", points)
            marks = head.landmark_positions(points.reshape(-1, 3)) * 1000.0
            lips.append(max(0.0, marks[LIPS[0], 2] - marks[LIPS[1], 2]))
            lids.append(np.mean([np.linalg.norm(marks[a] - marks[b]) for a, b in LIDS]))
        action = self.avatar.object.animation_data.action
        keys = sum(
            len(curve.keyframe_points) for layer in action.layers for strip in layer.strips for bag in strip.channelbags
            for curve in bag.fcurves
        )  # fmt: skip
        return {"lips": np.array(lips), "lids": np.array(lids), "keys": keys, "first": scene.frame_start}

    def render(self, frame: int, out: Path) -> Path:
        """Render one frame."""
        scene = self.bpy.context.scene
        scene.frame_set(frame)
        path = out / f"frame_{frame:04d}.png"
        scene.render.filepath = str(path)
        self.bpy.ops.render.render(write_still=True)
        return path


def _report(raw: dict[str, Any], clean: dict[str, Any], out: Path) -> None:
    """Numbers to the terminal, curves to files."""
    from PIL import Image, ImageDraw

    count = min(len(raw["lips"]), len(clean["lips"]))
    picture = Image.new("RGB", (PLOT[0], 2 * PLOT[1]), "white")
    draw = ImageDraw.Draw(picture)
    print(f"keys: {raw['keys']} recorded, {clean['keys']} reduced")
    for row, (name, title) in enumerate((("lips", "lips apart, mm"), ("lids", "lid opening, mm"))):
        before, after = raw[name][:count], clean[name][:count]
        jitter = [np.abs(np.diff(values, 3)).mean() for values in (before, after)]
        print(
            f"{title}: {before.min():.2f} to {before.max():.2f} recorded, {after.min():.2f} to {after.max():.2f} cleaned; "
            f"jitter {jitter[0]:.3f} recorded, {jitter[1]:.3f} cleaned; largest change {np.abs(after - before).max():.2f}"
        )
        top, high = row * PLOT[1], max(before.max(), after.max(), 1e-6)
        for values, color in zip((before, after), _COLORS, strict=True):
            x = np.linspace(0, PLOT[0] - 1, count)
            y = top + PLOT[1] - 10 - values / high * (PLOT[1] - 30)
            draw.line(list(zip(x.tolist(), y.tolist(), strict=True)), fill=color, width=1)
        draw.text((4, top + 2), f"{title} (grey: as recorded, red: calibrated, smoothed, reduced)", fill="black")
    picture.save(out / "curves.png")
    table = np.stack([raw["lips"][:count], clean["lips"][:count], raw["lids"][:count], clean["lids"][:count]], 1)
    columns = "lips recorded,lips cleaned,lids recorded,lids cleaned"
    np.savetxt(out / "curves.csv", table, "%.4f", ",", header=columns, comments="")


def _choose(clean: dict[str, Any], even: int, extreme: int) -> list[tuple[str, int]]:
    """Frames for the sheet with their captions."""
    first, count = clean["first"], len(clean["lips"])
    chosen = [(f"frame {first + k}", first + int(k)) for k in np.linspace(0, count - 1, even).round().astype(int)]
    for name, title in (("lips", "lips"), ("lids", "lids")):
        lows = _valleys(clean[name])[:extreme]
        chosen += [(f"{title} {clean[name][k]:.1f} mm, {first + k}", first + int(k)) for k in sorted(lows)]
    return chosen


def _valleys(values: np.ndarray) -> list[int]:
    """Frames of local minima, the deepest first, at least three frames apart."""
    inside = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])) + 1
    found: list[int] = []
    for k in inside[np.argsort(values[inside], kind="stable")]:
        if all(abs(int(k) - other) > 3 for other in found):
            found.append(int(k))
    return found


def _sheet(pictures: list[tuple[str, Path]], path: Path) -> None:
    from PIL import Image, ImageDraw

    rows = -(-len(pictures) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * TILE, rows * (TILE + CAPTION)), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (caption, file) in enumerate(pictures):
        x, y = number % COLUMNS * TILE, number // COLUMNS * (TILE + CAPTION)
        with Image.open(file) as image:
            sheet.paste(image.convert("RGB").resize((TILE, TILE), Image.Resampling.LANCZOS), (x, y + CAPTION))
        draw.text((x + 4, y + 2), caption, fill="black")
    sheet.save(path)


if __name__ == "__main__":
    sys.exit(main())
