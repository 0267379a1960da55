"""`python -m tools.people_pictures`: make pictures of people in `docs/images` anew: library, furrows, lights, random ones."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from grmm_core.avatar.library import LIBRARY_PREFIX, library_names
from grmm_core.controls.frame import Controls
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.geometry.camera import Camera
from grmm_core.light.parse import lighting_of
from grmm_core.light.shading import Response
from grmm_core.pictures.images import quantize
from grmm_core.session import FINAL_STRANDS, create_session
from grmm_core.session.api import Session
from grmm_core.session.values import Instance, RenderOptions
from grmm_core.session.wearing import GROOM_PREFIX, OWN_HAIR, HairUse

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "images"
PAPER = (0.86, 0.86, 0.86)
# a key, a rim and a world, as a photographer would stand them, and the wall behind
LIGHT, WALL = ("lamp:45,35,22", "lamp:-140,30,24,0.8,0.9,1", "world:0.24,0.92,0.98,1.1"), (0.2, 0.21, 0.23)
YAWS = (-25.0, 20.0, 0.0, 35.0, -40.0, 10.0, -10.0, 28.0)
# one after the other over the library: what an animator asks of everybody
EXPRESSIONS: tuple[Mapping[str, float], ...] = (
    {"laugh": 1.0}, {"visemeAA": 1.0}, {"browDownLeft": 1.0, "browDownRight": 1.0, "noseSneerLeft": 0.4, "noseSneerRight": 0.4},
    {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
)  # fmt: skip


# the studio, a key, a cold rim, a low sun, two colors, as docs/rendering.md says them; who stands in them, in which hair
LIGHTS: tuple[Sequence[str], ...] = (
    ("studio",), ("lamp:45,35,42", "world:0.05"),
    ("lamp:150,20,45,0.6,0.8,1", "lamp:-40,10,7,1,0.8,0.6", "world:0.02"),
    ("sun:60,7,4.5,1,0.5,0.2", "world:0.2,0.35,0.45,0.7"),
    ("lamp:70,10,30,1,0.15,0.5", "lamp:-70,10,30,0.1,0.6,1", "world:0.03"),
)  # fmt: skip
LIT = (("default", OWN_HAIR), ("library:beard", OWN_HAIR), ("library:freckles", f"{GROOM_PREFIX}long"))
NIGHT, LIT_SIZE = (0.13, 0.13, 0.13), 320
FURROWED = ("default", "library:grey", "library:bald")
FURROWING = (
    ("browInnerUp", "browOuterUp"),
    ("browDown", "noseSneer"),
    ("mouthSmile", "cheekSquint"),
    ("mouthPucker", "mouthShrugLower"),
)


def both(names: Sequence[str], weight: float = 0.9) -> dict[str, float]:
    """ARKit shapes of the given names, without their sides, at one weight."""
    return {name: weight for name in ARKIT_NAMES if name.removesuffix("Left").removesuffix("Right") in names}


def camera(size: int, yaw: float, fov: float = 18.0) -> Camera:
    """A head and its shoulders, square."""
    return Camera.orbit(size, size, yaw=yaw, pitch=4.0, distance=1.1, fov=fov, target=(0.0, -0.005, 0.015))


def drawn(session: Session, number: int, expression: Mapping[str, float], view: Camera, wrinkles: float = 1.0) -> np.ndarray:
    """One picture in the studio's light, uint8 [H, W, 3]."""
    instance = Instance(number, Controls().set_named(expression), wrinkles=wrinkles)
    return quantize(session.render([instance], view, RenderOptions(background=PAPER, strands=FINAL_STRANDS))["rgb"])


def lit(
    session: Session, number: int, expression: Mapping[str, float], view: Camera, light: Sequence[str] = LIGHT,
    wall: tuple[float, float, float] = WALL, hair: HairUse | None = None,
) -> np.ndarray:  # fmt: skip
    """One picture in a light, likewise."""
    lighting = lighting_of(light)
    response = None if lighting is None else Response()
    instance = Instance(number, Controls().set_named(expression), hair=hair or HairUse(), response=response)
    options = RenderOptions(background=wall, strands=FINAL_STRANDS, lighting=lighting)
    return quantize(session.render([instance], view, options)["rgb"])


def sheet(tiles: Sequence[np.ndarray], columns: int) -> Image.Image:
    """Pictures of one size in rows."""
    rows = [np.concatenate(tiles[i : i + columns], 1) for i in range(0, len(tiles), columns)]
    return Image.fromarray(np.concatenate(rows))


def main() -> int:
    """Draw and write; returns 0."""
    parser = argparse.ArgumentParser(description="Make the pictures of people in docs/images anew.")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder (default: %(default)s)")
    parser.add_argument("--size", type=int, default=224, help="pixels of each (default: %(default)s)")
    arguments = parser.parse_args()
    with create_session("local") as session:
        arguments.out.mkdir(parents=True, exist_ok=True)
        names = library_names()
        avatars = [session.open(LIBRARY_PREFIX + name).id for name in names]
        plain = [lit(session, who, {}, camera(arguments.size, YAWS[i % len(YAWS)])) for i, who in enumerate(avatars)]
        moved = [
            lit(session, who, EXPRESSIONS[i % len(EXPRESSIONS)], camera(arguments.size, -YAWS[i % len(YAWS)]))
            for i, who in enumerate(avatars)
        ]
        rows = [tile for i in range(0, len(plain), 8) for tile in (*plain[i : i + 8], *moved[i : i + 8])]
        sheet(rows, 8).save(arguments.out / "library.jpg", quality=85)
        faces = [session.open(name).id for name in FURROWED]
        near = camera(arguments.size, 15.0, 12.0)
        tiles = [drawn(session, who, both(each), near, much) for who in faces for much in (0.0, 1.0) for each in FURROWING]
        sheet(tiles, 8).save(arguments.out / "wrinkles.jpg", quality=85)
        upright = Camera.orbit(LIT_SIZE, LIT_SIZE, yaw=0.0, pitch=0.0, distance=1.1, fov=18.0)
        lamps = []
        for name, groom in LIT:
            person = session.open(name)
            hair = HairUse(groom, None if groom == OWN_HAIR else person.hair)  # another cut of the person's own color
            lamps += [lit(session, person.id, {}, upright, light, NIGHT, hair) for light in LIGHTS]
        sheet(lamps, len(LIGHTS)).save(arguments.out / "light.jpg", quality=85)
        people = [session.sample(seed).id for seed in range(24)]
        tiles = [lit(session, who, {}, camera(arguments.size, YAWS[i % len(YAWS)])) for i, who in enumerate(people)]
        sheet(tiles, 8).save(arguments.out / "random_people.jpg", quality=85)
    return 0


if __name__ == "__main__":
    sys.exit(main())
