"""`python -m tools.hair_pictures [PICTURE]`: make the pictures of hair in `docs/images` anew; "sheets" shows grooms closely.

`hair`: every groom; `hair_skins`: six on three skins; `hair_parts`: beards, hair at random, hair that swings. `sheets` writes
each groom on three skins from four sides to `--out`, at 1024 pixels a side unless told, for looking.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from grmm_core.avatar.library import LIBRARY_PREFIX
from grmm_core.controls.frame import Controls
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, groom_names
from grmm_core.pictures.images import quantize
from grmm_core.session import FINAL_STRANDS, HairUse, Instance, RenderOptions, create_session
from grmm_core.session.api import Session
from grmm_core.session.swinging import swinging
from grmm_core.session.wearing import GROOM_PREFIX, RANDOM_PREFIX

from .people_pictures import FOLDER, PAPER, camera, sheet

SKINS = ("freckles", "bald", "curly")  # of the library, light to dark
ONE, QUALITY = "bald", 82
LOOK = HairSettings(melanin=0.62, redness=0.15)
SIX = {"bob": 0.35, "wavy_long": 0.55, "curly": 0.9, "afro": 0.95, "quiff": 0.25, "braids": 0.8}  # and their melanin
BEARDS: tuple[tuple[str, HairSettings], ...] = (
    ("stubble", LOOK), ("short", LOOK), ("full", LOOK.changed(grey=0.8)), ("goatee", LOOK),
    ("moustache", LOOK.changed(melanin=0.35, redness=0.6)), ("full", LOOK),
)  # fmt: skip
SIDES = (0.0, 40.0, 90.0, 180.0)
WHOLE = 23.0  # degrees of a picture that has all of an afro or a mohawk
FPS, SHOWN = 30.0, (0, 14, 18, 24, 40, 59)  # frames of the shaken head


def drawn(session: Session, instance: Instance, view: Camera) -> np.ndarray:
    """One picture, uint8 [H, W, 3]."""
    return quantize(session.render([instance], view, RenderOptions(background=PAPER, strands=FINAL_STRANDS))["rgb"])


def hair(session: Session, size: int) -> Iterator[np.ndarray]:
    """Every groom on one head."""
    head = session.open(LIBRARY_PREFIX + ONE).id
    for name in groom_names():
        yield drawn(session, Instance(head, hair=HairUse(GROOM_PREFIX + name, LOOK)), camera(size, 50.0))


def hair_skins(session: Session, size: int) -> Iterator[np.ndarray]:
    """Six grooms on three skins."""
    for skin in SKINS:
        head = session.open(LIBRARY_PREFIX + skin).id
        for name, melanin in SIX.items():
            use = HairUse(GROOM_PREFIX + name, LOOK.changed(melanin=melanin))
            yield drawn(session, Instance(head, hair=use), camera(size, 30.0))


def hair_parts(session: Session, size: int) -> Iterator[np.ndarray]:
    """Beards, hair at random, hair that swings."""
    opened = session.open(LIBRARY_PREFIX + ONE)
    close = Camera.orbit(size, size, yaw=30.0, pitch=2.0, distance=1.1, fov=12.0, target=(0.0, -0.01, 0.03))
    for name, settings in BEARDS:
        yield drawn(session, Instance(opened.id, hair=HairUse(GROOM_PREFIX + "crop", settings, beard=name)), close)
    for seed in range(len(BEARDS)):
        yield drawn(session, Instance(opened.id, hair=HairUse(f"{RANDOM_PREFIX}{seed}", LOOK)), camera(size, 25.0))
    frames = []
    for t in np.arange(60) / FPS:
        pose = np.zeros((5, 3), np.float32)
        pose[1] = 0.5 * min(max(t - 1.0, 0.0) * 3.0, 1.0), 0.6 * np.sin(9.0 * t) * (t < 0.8), 0.0  # the neck: a bow, a shake
        frames.append(dataclasses.replace(Controls(), pose=pose))
    uses = swinging(session, opened, HairUse(GROOM_PREFIX + "long", LOOK), frames, FPS)
    for number, (controls, use) in enumerate(zip(frames, uses, strict=True)):
        if number in SHOWN:
            yield drawn(session, Instance(opened.id, controls, hair=use), camera(size, 25.0))


PICTURES = {"hair": (hair, 190, 9), "hair_skins": (hair_skins, 256, 6), "hair_parts": (hair_parts, 256, 6)}


def sheets(session: Session, size: int, out: Path) -> None:
    """Write NAME.jpg for each groom: three skins below each other, four sides beside each other."""
    heads = [session.open(LIBRARY_PREFIX + skin).id for skin in SKINS]
    for name in groom_names():
        use = HairUse(GROOM_PREFIX + name, LOOK)
        tiles = [drawn(session, Instance(head, hair=use), camera(size, yaw, WHOLE)) for head in heads for yaw in SIDES]
        sheet(tiles, len(SIDES)).save(out / f"{name}.jpg", quality=QUALITY)


def main() -> int:
    """Draw and write; returns 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "picture", choices=["all", *PICTURES, "sheets"], nargs="?", default="all", help="which (default: all but sheets)"
    )
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder (default: %(default)s)")
    parser.add_argument("--size", type=int, default=1024, help="pixels of each picture in a sheet (default: %(default)s)")
    arguments = parser.parse_args()
    with create_session("local") as session:
        for name in PICTURES if arguments.picture == "all" else (arguments.picture,):
            if name == "sheets":
                sheets(session, arguments.size, arguments.out)
                continue
            draw, size, columns = PICTURES[name]
            tiles = list(draw(session, size))
            tiles += [np.full_like(tiles[0], round(255 * PAPER[0]))] * (-len(tiles) % columns)
            sheet(tiles, columns).save(arguments.out / f"{name}.jpg", quality=QUALITY)
    return 0


if __name__ == "__main__":
    sys.exit(main())
