"""The contact sheet: identity, views, expressions, refinement, other people, and frames of the rendered sequence."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from grmm_core.controls.frame import Controls
from grmm_core.geometry.camera import Camera
from grmm_core.pictures.images import quantize
from grmm_core.session import FINAL_STRANDS, Instance, RenderOptions, Session

TILE = 256  # pixels
COLUMNS = 6
CAPTION = 16
BACKGROUND = (0.94, 0.94, 0.94)
_VIEWS = (("front", 0, 0), ("30 left", 30, 0), ("60 right", -60, 0), ("profile", 90, 0), ("back", 180, 0), ("above", 20, 35))
_EXPRESSIONS = (
    ("smile", {"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9}),
    ("jaw open", {"jawOpen": 0.9}),
    ("blink", {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}),
    ("pucker", {"mouthPucker": 1.0}),
    ("surprise", {"surprise": 1.0}),
    ("disgust", {"disgust": 1.0}),
    ("visemeFV", {"visemeFV": 1.0}),
    ("tongue", {"tongueOut": 1.0, "jawOpen": 0.35}),
    ("gaze left", {"eyes.yaw": 0.4}),
    ("cheeks", {"cheekPuff": 1.0}),
    ("brows", {"browInnerUp": 1.0, "browOuterUpLeft": 1.0}),
    ("turned", {"neck.y": 0.3, "mouthSmileLeft": 0.5}),
)
_FACE = (0.0, -0.01, 0.08)  # a point between nose and mouth, head space


def write_sheet(path: Path, session: Session, frames: Sequence[Path]) -> None:
    """Render and write the sheet.

    Args:
        path: PNG to write.
        session: Renders the default avatar.
        frames: Pictures of the sequence that Blender rendered, in order.
    """
    avatar = session.open("default")
    rows: list[list[tuple[str, Image.Image]]] = []

    def tile(controls: dict[str, float], camera: Camera, refine: bool = True, avatar_id: int = avatar.id) -> Image.Image:
        instance = Instance(avatar_id, Controls().set_named(controls))
        options = RenderOptions(refine=refine, passes=("rgb",), background=BACKGROUND, strands=FINAL_STRANDS)
        return Image.fromarray(quantize(session.render([instance], camera, options)["rgb"]))

    whole = functools.partial(Camera.orbit, TILE, TILE, distance=1.3, fov=20.0)
    close = functools.partial(Camera.orbit, TILE, TILE, distance=1.0, fov=14.0, target=_FACE)
    rows.append([(n, tile({}, whole(yaw=y, pitch=p))) for n, y, p in _VIEWS])
    for start in range(0, len(_EXPRESSIONS), COLUMNS):
        camera = close(yaw=10.0)
        rows.append([(name, tile(values, camera)) for name, values in _EXPRESSIONS[start : start + COLUMNS]])
    camera = close()
    pair = {"mouthSmileLeft": 0.6, "mouthSmileRight": 0.6, "jawOpen": 0.2}
    samples = [session.sample(seed).id for seed in range(COLUMNS - 2)]
    rows.append(
        [
            ("unrefined", tile(pair, camera, refine=False)),
            ("refined", tile(pair, camera)),
            *((f"sample {i}", tile({}, whole(yaw=15.0), avatar_id=s)) for i, s in enumerate(samples)),
        ]
    )
    chosen = [frames[i] for i in np.linspace(0, len(frames) - 1, 2 * COLUMNS).round().astype(int)]
    for start in range(0, len(chosen), COLUMNS):
        rows.append([(f"Blender {p.stem}", _load_tile(p)) for p in chosen[start : start + COLUMNS]])
    _paste(rows).save(path)


def _load_tile(path: Path) -> Image.Image:
    with Image.open(path) as image:
        picture = image.convert("RGBA").resize((TILE, TILE), Image.Resampling.LANCZOS)
    ground = Image.new("RGBA", picture.size, tuple(round(255 * c) for c in BACKGROUND))
    return Image.alpha_composite(ground, picture).convert("RGB")


def _paste(rows: list[list[tuple[str, Image.Image]]]) -> Image.Image:
    sheet = Image.new("RGB", (COLUMNS * TILE, len(rows) * (TILE + CAPTION)), "white")
    draw = ImageDraw.Draw(sheet)
    for r, row in enumerate(rows):
        for c, (caption, picture) in enumerate(row):
            x, y = c * TILE, r * (TILE + CAPTION)
            sheet.paste(picture, (x, y + CAPTION))
            draw.text((x + 4, y + 2), caption, fill="black")
    return sheet
