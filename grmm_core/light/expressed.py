"""The rig's light in colors that change with the expression. Needs numpy; numba makes it faster.

What an expression adds to learned colors is mostly what the rig makes of the moved skin: a lid that shuts turns into its
light, a cheek that is lifted out of it. A scene's light falls on the moved skin anyway, so this must not be counted twice: the
rig that is taken off follows the colors, by patches as large as the mesh's faces. Finer changes (furrows, blood) stay colors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .resting import MOUTH, RestLight, Texels
from .shadows import compiled_kernels

if TYPE_CHECKING:
    from ..head import HeadModel

_LEAST, _MOST = 0.5, 2.0  # of the rig at rest: shut lids get 1.4 times as much
_HARDLY = np.float32(1e-4)  # of a texel
_STILL = 1e-8  # square metres: what moves by less than 0.1 mm stays where it is
_PLACES = 3  # of how far an eye is shut: a head that only turns finds what is known of its face
_DARK = 0.02  # display value that colors have at least


def brightness(texels: Texels, colors: np.ndarray, tint: np.ndarray, count: int) -> np.ndarray:
    """How bright colors are around vertices, as sums over texels: the squares of display values stand for linear light.

    Args:
        texels: N of them.
        colors: Display sRGB, [N, 3].
        tint: Added to them, [N, 3].
        count: Of vertices, V.

    Returns:
        [V] float32.
    """
    if compiled_kernels() is None:
        bright = ((colors + tint).clip(_DARK, 1.0) ** 2).sum(1)[:, None] * texels.barycentric
        return np.bincount(texels.corners.ravel(), bright.ravel(), count).astype(np.float32)
    from .light_kernels import brightness_around

    sums = np.zeros(count, np.float32)
    given = (np.ascontiguousarray(array, np.float32) for array in (colors, tint))
    brightness_around(*given, texels.corners, texels.barycentric, np.float32(_DARK), sums)
    return sums


def shut_eyes(rest: RestLight, vertices: np.ndarray) -> np.ndarray:
    """How far an expression shuts the eye that vertices are near to, 0..1, [V] float32; 0 where no eye moves them.

    Args:
        rest: Of the head at rest.
        vertices: In the expression, axes of the head at rest, [V, 3].
    """
    way = np.einsum("vc,evc->e", vertices - rest.vertices, rest.shutting)
    moves = np.einsum("evc,evc->ev", rest.shutting, rest.shutting)
    shut = (way / np.maximum(moves.sum(1), _STILL)).clip(0.0, 1.0).round(_PLACES)
    return ((shut @ moves) / (moves.sum(0) + _STILL)).astype(np.float32)


def rig_in_colors(
    rig: np.ndarray, head: HeadModel, texels: Texels, rest: np.ndarray, posed: np.ndarray, shut: np.ndarray,
    turned_out: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """The rig's irradiance that colors hold in an expression.

    Lids that shut turn out of the brow's shade, and what of them is hidden at rest has colors that are learned where it is
    seen: where eyes are shut the rig is as on shut lids, if that is more. Colors of teeth, tongue and inner mouth say nothing
    of themselves at rest; they keep what `resting` found for them.

    Args:
        rig: What they hold at rest, [N, 3].
        head: Head model.
        texels: Where.
        rest: `brightness` at rest, [V].
        posed: `brightness` in the expression, [V].
        shut: `shut_eyes` of the expression, [V].
        turned_out: How many times as much of the rig vertices get where eyes are shut, [V].

    Returns:
        [N, 3] float32.
    """
    change = ((posed + _HARDLY) / (rest + _HARDLY)).clip(_LEAST, _MOST)  # vertices with hardly a texel around stay as they are
    change += shut * (turned_out - change).clip(0.0, None)
    change[head.marked(*MOUTH)] = 1.0
    result: np.ndarray = texels.at(change[:, None])
    return rig * result
