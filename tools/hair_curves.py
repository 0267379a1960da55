"""Make `docs/images/hair_curves.jpg` anew: `python -m tools.hair_curves [--person ID] [--output FILE]`.

A groom, the same as curves that were combed on one side and cut on the other, on a turned head, and these in Cycles: all in
the same lamps, which light the avatar too. Needs the bpy wheel in this Python.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench_blender import with_extension
from tools.build_extension import BuildError
from tools.light_pictures import _light, _shot

OUTPUT = Path(__file__).resolve().parents[1] / "docs/images/hair_curves.jpg"
SIZE, SAMPLES, QUALITY = 400, 48, 87
SCALP_PART = 1  # of the attribute that says what a curve is part of
SWEPT, CUT = (
    (0.14, 0.46, 0.23),
    0.35,
)  # of its length that a tip is combed, Blender's axes; share left on the other side


def pictures(person: str, groom: str, folder: Path) -> list[np.ndarray]:
    """Render the four, [H, W, 3] uint8 each."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.grmm.add_head(person="LIBRARY", library=person)
    head = importlib.import_module("bl_ext.user_default.grmm.grmm_blender.rig.avatar").avatar_of(bpy.context.object).object
    head.grmm.lighting = "SCENE"
    head.grmm.hair.groom, head.grmm.hair.melanin = groom, 0.45
    _light(scene)
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    yaw = math.radians(28.0)
    scene.camera.location = (1.5 * math.sin(yaw), -1.5 * math.cos(yaw), 0.01)
    scene.camera.rotation_euler, scene.camera.data.lens = (math.pi / 2, 0.0, yaw), 175.0
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "Standard"
    scene.render.engine = "GRMM"
    shots = [_shot(scene, folder / "groom.png")]
    bpy.ops.grmm.hair_as_curves(sculpt=False)
    comb(head.grmm.hair.curves.data)
    shots.append(_shot(scene, folder / "combed.png"))
    bone = head.parent.pose.bones["neck"]
    bone.rotation_mode, bone.rotation_euler, head["jawOpen"] = "XYZ", (0.1, -0.5, 0.1), 0.6
    head.update_tag()
    shots.append(_shot(scene, folder / "turned.png"))
    bone.rotation_euler, head["jawOpen"] = (0.0, 0.0, 0.0), 0.0
    head.update_tag()
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", SAMPLES, True
    shots.append(_shot(scene, folder / "cycles.png"))
    return shots


def comb(data: Any) -> None:
    """Comb the scalp's curves of one side backwards, and cut those of the other."""
    flat, parts = np.empty(3 * len(data.points), np.float32), np.empty(len(data.curves), np.int32)
    data.attributes["position"].data.foreach_get("vector", flat)
    data.attributes["grmm_part"].data.foreach_get("value", parts)
    points = flat.reshape(-1, 3)
    counts = np.array([curve.points_length for curve in data.curves])
    starts = np.cumsum(counts) - counts
    scalp = np.flatnonzero(parts == SCALP_PART)
    count = int(counts[scalp[0]])  # of all: a packaged groom has even strands
    rows = starts[scalp, None] + np.arange(count)
    strands, t = points[rows], np.linspace(0, 1, count, dtype=np.float32)
    left = strands[:, 0, 0] > 0.012
    lengths = np.linalg.norm(np.diff(strands[left], axis=1), axis=2).sum(1)
    strands[left] += (lengths[:, None] * t**1.5)[..., None] * np.array(SWEPT, np.float32)
    at = CUT * t * (count - 1)
    base = np.minimum(at.astype(int), count - 2)
    part = (at - base)[None, :, None]
    strands[~left] = strands[~left][:, base] * (1 - part) + strands[~left][:, base + 1] * part
    points[rows] = strands
    data.attributes["position"].data.foreach_set("vector", flat)
    data.update_tag()


def main() -> int:
    """Render and write the JPEG; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--person", default="layered", help="avatar of the library (%(default)s)")
    parser.add_argument("--groom", default="long", help="which hair (%(default)s)")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="JPEG (%(default)s)")
    arguments = parser.parse_args()
    from PIL import Image

    try:
        with tempfile.TemporaryDirectory(prefix="grmm-curves-") as folder:
            shots = with_extension(lambda: {"shots": pictures(arguments.person, arguments.groom, Path(folder))})["shots"]
    except BuildError as error:
        print(f"hair_curves: {error}", file=sys.stderr)
        return 1
    Image.fromarray(np.concatenate(shots, 1)).save(arguments.output, quality=QUALITY)
    return 0


if __name__ == "__main__":
    sys.exit(main())
