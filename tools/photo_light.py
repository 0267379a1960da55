"""Fitted avatars with their photos' light taken out: `python -m tools.photo_light -o SHEET AVATAR=PHOTO...`.

A row each: the photo, the avatar in its view under the photo's light, the same under the studio's even rig, and at rest under a
lamp from a side. Prints the color error of each fit in its photo, and how much of its lightness follows the normals beyond what
does in the rig (`evaluation.evenness`): in the photo, in the photo's light and in the rig; each as spread, left over right, up
over down.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from grmm_core.avatar import load_avatar
from grmm_core.controls.frame import Controls
from grmm_core.evaluation.cleanliness import Shot
from grmm_core.evaluation.evenness import Evenness, evenness
from grmm_core.fitting.photo_light import MATT
from grmm_core.fitting.result import photo_camera, photo_controls, photo_light
from grmm_core.fitting.track import frame_of
from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head
from grmm_core.light.lamps import Lighting
from grmm_core.light.parse import lighting_of
from grmm_core.light.shading import Response
from grmm_core.model.portrait import portrait_camera
from grmm_core.pictures.images import quantize
from grmm_core.session import Instance, RenderOptions, create_session

SIDE = 320
LAMP = ("lamp:70,20,60", "world:0.08")
GREY = (0.5, 0.5, 0.5)


def row(avatar_file: Path, photo_file: Path) -> tuple[np.ndarray, float, list[Evenness]]:
    """The pictures of one avatar, [SIDE, 4 SIDE, 3] uint8, its color error in the photo, and how even the first three are."""
    avatar, head = load_avatar(avatar_file), load_open_head()
    whole, posed, own = photo_camera(avatar), photo_controls(avatar, head), photo_light(avatar).lighting
    left, top, width = frame_of(whole)
    camera = whole.crop(int(left), int(top), int(width), int(width)).resized(SIDE, SIDE)
    with Image.open(photo_file) as opened:
        photo = ImageOps.exif_transpose(opened).convert("RGB").resize((whole.width, whole.height))
    cut = photo.crop((int(left), int(top), int(left) + int(width), int(top) + int(width))).resize((SIDE, SIDE))
    with create_session("local") as session:
        number = session.open(avatar_file).id

        def shot(controls: Controls, camera: Camera, light: Lighting | None, response: Response) -> Shot:
            options = RenderOptions(passes=("rgb", "alpha", "hair"), background=GREY, lighting=light)
            drawn = session.render([Instance(number, controls, response=response)], camera, options)
            vertices = np.asarray(session.deform(number, controls).vertices, np.float64)
            return Shot(vertices, camera, drawn["rgb"], drawn["alpha"][..., 0], drawn["hair"][..., 0])

        lit, even = shot(posed, camera, own, MATT), shot(posed, camera, None, MATT)
        lamp = shot(Controls(), portrait_camera(SIDE, 0.0, 0.0), lighting_of(LAMP), Response())
    colors = [np.asarray(cut, np.float32) / 255.0, lit.rgb, even.rgb, lamp.rgb]
    found = [evenness(picture, even, head) for picture in colors[:3]]
    return np.concatenate([quantize(picture) for picture in colors], 1), float(avatar.tracking["rmse"][0]), found


def main() -> int:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", nargs="+", metavar="AVATAR=PHOTO")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    rows = []
    for pair in args.pairs:
        avatar, photo = map(Path, pair.split("=", 1))
        pictures, error, found = row(avatar, photo)
        rows.append(pictures)
        told = ", ".join(f"{one.spread:.3f} ({one.aside:.2f}, {one.up:.2f})" for one in found)
        print(f"{avatar.stem}: {error:.4f}, light in the photo, in its light and in the rig {told}")
    Image.fromarray(np.concatenate(rows)).save(args.output, quality=88)
    return 0


if __name__ == "__main__":
    sys.exit(main())
