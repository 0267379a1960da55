"""What further photos give a fit: `python -m tools.several_photos -o FOLDER [--people 2] [--counts 1 2 4 8] [--preset fast]`.

People drawn at random from the model are photographed from different sides in different lights, with small expressions, as a
camera exposes them and above the edge of their bust, and fitted from the pictures alone. Printed are, by the number of photos,
the color error in each photo as a session draws it, the error of the shape, and PSNR of faces in views and expressions that no
photo shows: of skin that neither wears strands before, in even light, drawn on the true mesh, so that it tells of colors alone,
each color's gain free, since the first photo's exposure stays in the avatar.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from grmm_core.avatar import Avatar, save_avatar
from grmm_core.controls.frame import Controls
from grmm_core.fitting.api import fit
from grmm_core.fitting.invert import photo_views
from grmm_core.fitting.photo_light import MATT
from grmm_core.fitting.request import FitRequest
from grmm_core.fitting.result import photo_controls, photo_light
from grmm_core.fitting.types import PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import triangle_depth
from grmm_core.light.lamps import STUDIO
from grmm_core.light.parse import lighting_of
from grmm_core.light.relight import to_linear
from grmm_core.light.shading import Response
from grmm_core.light.transfer import turn_between
from grmm_core.model.portrait import portrait_camera
from grmm_core.pictures.images import quantize, write_png
from grmm_core.session import HairUse, Instance, RenderOptions, make_local_session
from grmm_core.session.local import LocalSession

SIDE, HELD_OUT_SIDE = 512, 256
GREY = (0.45, 0.5, 0.55)
Taken = tuple[float, float, dict[str, float], tuple[str, ...]]
"""Yaw, pitch, expression and light of a photo."""
PHOTOS: tuple[Taken, ...] = (
    (0.0, 0.0, {}, ("sun:40,30,2", "world:0.5")),
    (35.0, 0.0, {"mouthSmileLeft": 0.5, "mouthSmileRight": 0.5}, ("lamp:-50,20,60", "world:0.4,1,0.95,0.85")),
    (-35.0, 5.0, {}, ("sun:-60,40,2.5,1,0.9,0.75", "world:0.5,0.85,0.95,1")),
    (10.0, -15.0, {"jawOpen": 0.2}, ("lamp:20,60,80", "world:0.3")),
    (-15.0, 15.0, {"browInnerUp": 0.4}, ("world:1.2",)),
    (45.0, 5.0, {}, ("sun:100,20,2.5", "world:0.6")),
    (-45.0, 0.0, {"mouthSmileLeft": 0.3, "mouthSmileRight": 0.3}, ("sun:20,60,2.5", "world:0.4")),
    (0.0, 10.0, {"mouthPucker": 0.3}, ("lamp:0,0,50", "world:0.3,1,0.9,0.8")),
)
HELD_OUT: tuple[tuple[float, float, dict[str, float]], ...] = (
    (20.0, 0.0, {}), (-25.0, -8.0, {}), (60.0, 0.0, {}), (-60.0, 5.0, {}),
    (0.0, 0.0, {"mouthSmileLeft": 0.7, "mouthSmileRight": 0.7}),
)  # fmt: skip
EXPOSED = 90.0, 0.85  # percentile of the picture's brightest channel of skin, and what a camera makes of it, display sRGB
BELOW = 0.3  # of the face's height: how much below the chin is in a picture
BARE, BROWS = HairUse("none", brows="none", beard="none", lashes="none"), HairUse("none")
EXPOSURES = 3  # until that holds: light is not doubled by twice the lamps where it is clipped
COVERED = 0.02  # of a pixel by hair, of which photos tell no skin


def shot(session: LocalSession, number: int, controls: Controls, camera: Camera, **more: object) -> dict[str, np.ndarray]:
    """One picture; `more` is the instance's."""
    options = RenderOptions(passes=("rgb", "hair"), background=GREY)
    drawn: dict[str, np.ndarray] = session.render([Instance(number, controls, **more)], camera, options)  # type: ignore[arg-type]
    return drawn


def photos_of(session: LocalSession, person: int, folder: Path, photos: Sequence[Taken]) -> list[Path]:
    """Photograph a person."""
    paths = []
    for index, (yaw, pitch, values, words) in enumerate(photos):
        controls, lighting = Controls().set_named(values), lighting_of(words) or STUDIO
        camera, face = _framed(session, person, controls, Camera.orbit(SIDE, SIDE, yaw, pitch, distance=1.2, fov=22.0))
        for _ in range(EXPOSURES):
            drawn = shot(session, person, controls, camera, lighting=lighting, response=Response())["rgb"]
            bright = float(to_linear(np.percentile(drawn[face].max(-1), EXPOSED[0])))
            lighting = lighting.scaled((float(to_linear(np.array(EXPOSED[1]))) / bright,) * 3)
        paths.append(folder / f"photo{index + 1}.png")
        write_png(paths[-1], quantize(drawn))
    return paths


def _framed(session: LocalSession, person: int, controls: Controls, camera: Camera) -> tuple[Camera, np.ndarray]:
    """The camera whose picture ends below the chin, and the pixels that show the face, [H, W] bool."""
    head = session.engine.store.default().model.head_model
    vertices = np.asarray(session.deform(person, controls).vertices, np.float64)
    face = head.marked("face")
    rows = camera.project(vertices[face])[1][:, 1]
    end = min(SIDE, round(float(rows.max() + BELOW * np.ptp(rows))))
    camera = camera.crop(0, 0, SIDE, end)
    return camera, _shows(vertices, head.faces[face[head.faces].all(1)], head.faces, camera)


def errors_in_photos(session: LocalSession, path: Path, avatar: Avatar, tracks: Sequence[PhotoTrack]) -> list[float]:
    """Color error of a fitted avatar, strands and all, in each of its photos' lights."""
    model, number, errors = session.engine.store.default().model, session.open(path).id, []
    for view in photo_views(model, tracks, SIDE):
        lighting, controls = photo_light(avatar, view.index).lighting, photo_controls(avatar, model.head_model, view.index)
        drawn = shot(session, number, controls, view.camera, response=MATT, lighting=lighting)
        measured, cover = view.measured.cpu().numpy(), view.mask.cpu().numpy()[..., None]
        target = view.image.cpu().numpy() * cover + np.array(GREY) * (1.0 - cover)
        squares = ((drawn["rgb"] - target) ** 2).mean(-1) * measured
        errors.append(float(np.sqrt(squares.sum() / measured.sum())))
    session.release(number)
    return errors


def held_out(session: LocalSession, person: int, avatar: Avatar, folder: Path) -> tuple[float, float]:
    """PSNR of the face in views that no photo shows, dB, and the mean error of its shape, metres."""
    truth, head = session.target(person).avatar, session.engine.store.default().model.head_model
    face = head.marked("face")
    shapes = [head.vertices(one.shape, np.zeros(1), np.zeros((5, 3)))[face] for one in (avatar, truth)]
    ours, theirs = (shape - shape.mean(0) for shape in shapes)
    ours = ours @ turn_between(ours, theirs).T
    apart = float(np.linalg.norm(ours * ((ours * theirs).sum() / (ours * ours).sum()) - theirs, axis=1).mean())
    path = folder / "on_true_mesh.grmm"
    save_avatar(dataclasses.replace(avatar, shape=truth.shape), path)
    number = session.open(path).id
    squares: list[np.ndarray] = []
    for yaw, pitch, values in HELD_OUT:
        controls, camera = Controls().set_named(values), portrait_camera(HELD_OUT_SIDE, yaw, pitch)
        drawn = [shot(session, one, controls, camera, hair=BARE)["rgb"] for one in (number, person)]
        worn = [(number, BROWS), (person, HairUse())]
        vertices = np.asarray(session.deform(person, controls).vertices, np.float64)
        seen = _shows(vertices, head.faces[face[head.faces].all(1)], head.faces, camera)
        for one, hair in worn:
            seen &= shot(session, one, controls, camera, hair=hair)["hair"][..., 0] < COVERED
        a, b = (picture[seen] for picture in drawn)
        squares.append(((a * ((a * b).sum(0) / (a * a).sum(0)) - b) ** 2).mean(1))
    session.release(number)
    return float(-10.0 * np.log10(np.concatenate(squares).mean())), apart


def _shows(vertices: np.ndarray, part: np.ndarray, every: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels that show a part of a mesh, [H, W] bool."""
    there: np.ndarray = triangle_depth(vertices[part], camera)
    return np.isfinite(there) & (there < 5.0) & (there <= triangle_depth(vertices[every], camera) + 1e-4)


def main() -> int:
    """Fit and print a line a person and count."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--first", type=int, default=1000, help="seed of the first")
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--preset", default="fast")
    args = parser.parse_args()
    rows: dict[int, list[tuple[float, ...]]] = {count: [] for count in args.counts}
    with make_local_session(engine="torch") as session:
        for seed in range(args.first, args.first + args.people):
            folder = args.output / str(seed)
            folder.mkdir(parents=True, exist_ok=True)
            person = session.sample(seed).id
            photos = photos_of(session, person, folder, PHOTOS[: max(args.counts)])
            for count in args.counts:
                result = fit(FitRequest(tuple(photos[:count]), folder / f"{count}.grmm", args.preset))
                errors = errors_in_photos(session, result.path, result.avatar, result.tracks)
                decibels, apart = held_out(session, person, result.avatar, folder)
                figures = " ".join(f"{error:.4f}" for error in errors)
                print(f"{seed} {count}: {decibels:.2f} dB, shape {1e3 * apart:.2f} mm, in the photos {figures}", flush=True)
                rows[count].append((decibels, 1e3 * apart, max(errors)))
    for count, found in rows.items() if args.people > 1 else ():
        decibels, apart, most = np.mean(found, 0)
        print(f"mean {count}: {decibels:.2f} dB, shape {apart:.2f} mm, in the worst photo {most:.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
