"""Fits of people in hard lights: `python -m tools.lit_photos -o FOLDER [--people default beard grey] [--lights window noon]`.

People of the library, with brows, beards and hair of their own, are photographed in soft light, beside a window, in a lamp from
the side, and in the sun at noon, as a camera exposes them, and fitted from one picture alone. Printed are the color error in
the photo, the exposure that is left in the avatar (its skin over the person's in even light), PSNR of faces in views that the
photo does not show (`several_photos.held_out`), the error of the shape, and how far the beard is where the person has one:
intersection over union from the front.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from grmm_core.controls.frame import Controls
from grmm_core.fitting.api import fit
from grmm_core.fitting.request import FitRequest
from grmm_core.light.relight import to_linear
from grmm_core.model.portrait import portrait_camera
from grmm_core.session import HairUse, make_local_session
from grmm_core.session.local import LocalSession

from .several_photos import BARE, HELD_OUT_SIDE, errors_in_photos, held_out, photos_of, shot

PEOPLE = ("default", "beard", "grey", "locs")
LIGHTS = {
    "soft": ("lamp:35,30,60", "world:0.5"), "window": ("lamp:-72,15,60", "world:0.25"), "side": ("lamp:80,10,60", "world:0.04"),
    "noon": ("sun:25,60,3", "world:0.25"),
}  # fmt: skip
"""What shines on the person; the camera looks from the left by eight degrees."""
BEARD = HairUse("none", brows="none", lashes="none")
COVERED = 0.1  # of a pixel, by strands
MIDDLE = slice(HELD_OUT_SIDE * 2 // 5, HELD_OUT_SIDE * 3 // 5)  # rows and columns of the face's middle


def exposure(session: LocalSession, person: int, fitted: int) -> float:
    """Median of a fitted avatar's skin over the person's, linear, in even light from the front."""
    camera = portrait_camera(HELD_OUT_SIDE)
    both = (shot(session, one, Controls(), camera, hair=BARE)["rgb"][MIDDLE, MIDDLE] for one in (fitted, person))
    ours, theirs = (to_linear(picture).mean(-1) for picture in both)
    return float(np.median(ours / np.maximum(theirs, 1e-3)))


def overlap(session: LocalSession, person: int, fitted: int) -> float:
    """Intersection over union of beards from the front; not a number where neither has any."""
    camera = portrait_camera(HELD_OUT_SIDE)
    ours, theirs = (shot(session, one, Controls(), camera, hair=BEARD)["hair"][..., 0] > COVERED for one in (fitted, person))
    return float((ours & theirs).sum() / (ours | theirs).sum()) if (ours | theirs).any() else float("nan")


def main() -> int:
    """Fit and print a line a person and light."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--people", nargs="+", default=list(PEOPLE))
    parser.add_argument("--lights", nargs="+", choices=LIGHTS, default=list(LIGHTS))
    parser.add_argument("--preset", default="fast")
    args = parser.parse_args()
    with make_local_session(engine="torch") as session:
        for name in args.people:
            person = session.open(name if name == "default" else f"library:{name}").id
            for light in args.lights:
                folder = args.output / f"{name}_{light}"
                folder.mkdir(parents=True, exist_ok=True)
                photos = photos_of(session, person, folder, [(8.0, 0.0, {}, LIGHTS[light])])
                result = fit(FitRequest(tuple(photos), folder / "avatar.grmm", args.preset))
                (error,) = errors_in_photos(session, result.path, result.avatar, result.tracks)
                decibels, apart = held_out(session, person, result.avatar, folder)
                fitted = session.open(result.path).id
                print(
                    f"{name} {light}: {error:.4f} in the photo, exposure {exposure(session, person, fitted):.2f}, "
                    f"{decibels:.1f} dB, shape {1e3 * apart:.1f} mm, beard {overlap(session, person, fitted):.2f}", flush=True,
                )  # fmt: skip
                session.release(fitted)
    return 0


if __name__ == "__main__":
    sys.exit(main())
