"""The furrows of an avatar's expression: what a session keeps of them. `compose` calls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..compute.recent import Recent
from ..geometry.camera import Camera
from ..geometry.libraries import as_like, present, to_numpy
from ..head import load_open_head, load_people_model
from ..light.lamps import Lighting
from ..light.rough import harmonics_of, rig_harmonics
from ..light.transfer import vertex_normals
from ..splat.types import RasterOutput
from ..wrinkles.furrows import Furrows, sizes_of
from ..wrinkles.relief import FINER, Relief, age_of, seed_of
from .evaluator import Evaluator, Inputs, OpenAvatar

_DIRECTED = 0.6  # of how a scene's light differs by direction: where it is shadowed is not asked, and skin scatters
_MIDDLE = 0.5  # of a pixel or texel
_RELIEFS: Recent[Relief] = Recent(2)  # a fit opens its person several times


def furrows_of(
    evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, strength: float, lighting: Callable[[], Lighting | None]
) -> Furrows | None:
    """The furrows of an avatar; None where its face is smooth, and on heads other than the open one.

    Those of its face at rest and of the photos that it was made from are in its colors.

    Args:
        evaluator: Of the session.
        target: Who.
        inputs: Of the frame.
        strength: Factor of their height.
        lighting: What gives light in head space, or None for the studio's; it is asked for a face that has furrows only.
    """
    head, layout = target.model.head_model, target.model.layout
    still = target.still.expression
    if not strength or np.array_equal(inputs.expression, still) or head.name != load_open_head().name:
        return None

    def paint() -> Relief:
        own = target.avatar.shape
        person = seed_of(own), age_of(own, load_people_model())
        return _RELIEFS.get((head, layout.uv, layout.grid, *person), lambda: Relief.of(head, layout.uv, layout.grid, *person))

    relief = Relief(*evaluator.cache.get((target.id, "furrow relief"), paint))
    held = np.stack([still, *_of_photos(target, len(still))])

    def hold() -> tuple[np.ndarray]:
        return (relief.driven(*held),)

    def rise() -> tuple[np.ndarray, ...]:
        taken = evaluator.cache.get((target.id, "furrows held", held.tobytes()), hold)[0] if held.any() else None
        heights = relief.heights(inputs.expression, taken)
        return () if heights is None else (sizes_of(heights * np.float32(strength)),)

    key = (inputs.expression.tobytes(), held.tobytes(), strength)
    levels = evaluator.cache.get((target.id, "furrow heights", *key), rise)
    if not levels:
        return None
    vertices = to_numpy(evaluator.mesh(target, inputs).vertices).astype(np.float32)

    def lie() -> tuple[np.ndarray, ...]:
        corners = np.asarray(layout.uv)[head.uv_faces[relief.faces]] * (layout.grid * FINER) - _MIDDLE - relief.corner[::-1]
        return np.ascontiguousarray(head.faces[relief.faces], np.int32), corners.astype(np.float32)

    def lean() -> tuple[np.ndarray]:
        return (vertex_normals(vertices, head.faces).astype(np.float32),)

    faces, places = evaluator.cache.get((target.id, "furrow places"), lie)
    normals = evaluator.cache.get((target.id, "vertex normals", *inputs.mesh_key), lean)[0]
    scene = lighting()
    light = rig_harmonics().copy() if scene is None else harmonics_of(scene)
    light[1:] *= 1.0 if scene is None else _DIRECTED
    size = int(relief.size[0]), int(relief.size[1])
    return Furrows(levels[0], size, faces, places, vertices, normals, light.astype(np.float32))


def with_furrows(found: Sequence[tuple[Furrows, Camera]], refined: Any, raster: RasterOutput[Any], skin: int | None) -> Any:
    """A refined picture with furrows, [H, W, 3]; what was splatted stays as it is.

    Args:
        found: Furrows of avatars, each with the camera in its head space.
        refined: Premultiplied, [H, W, 3].
        raster: What it was refined from.
        skin: Number of the channel that holds how much of the cover is skin; None: all.
    """
    if not found:
        return refined
    picture = np.array(to_numpy(refined), np.float32, order="C")
    share = None if skin is None else to_numpy(present(raster.features))[..., skin]
    for furrows, camera in found:
        furrows.draw(picture, to_numpy(raster.depth), to_numpy(raster.alpha), share, camera)
    return as_like(picture, refined)


def _of_photos(target: OpenAvatar, count: int) -> np.ndarray:
    """Expression coefficients in the photos that an avatar was made from, [P, count]."""
    tracked = target.avatar.tracking.get("expression", np.zeros((0, 0), np.float32))
    found = np.zeros((len(tracked) if tracked.ndim == 2 else 0, count), np.float32)
    if len(found):
        shared = min(count, tracked.shape[1])
        found[:, :shared] = tracked[:, :shared]
    return found
