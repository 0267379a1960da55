"""What the steps of the forward chain give, and small steps that are one text for arrays and tensors.

The chain is `inputs` -> `Rest`, `Mesh` -> `Geometry` of the Gaussians -> picture, whichever library computes it. Numpy only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, NamedTuple

import numpy as np

from ..geometry.libraries import Array, library_of, zeros
from .config import GRMMConfig

if TYPE_CHECKING:
    from ..head import HeadModel

HEAD_CENTRE: tuple[float, float, float] = (0.0, 0.0, 0.0)
"""Point from which view directions are taken: between the ears, head space, metres."""
TEETH_REGIONS = ("upper_teeth", "lower_teeth")
COVERED = 0.5  # alpha above which a pixel's depth counts for the normalisation
_DEPTH_SPAN_MIN = 1e-6  # metres


class Rest(NamedTuple, Generic[Array]):
    """A shaped head before expression and pose: vertices [..., V, 3] and joints [..., 5, 3], metres."""

    vertices: Array
    joints: Array


class Mesh(NamedTuple, Generic[Array]):
    """A posed mesh.

    Attributes:
        vertices: v_d of eq. 11 after skinning, [..., V, 3] metres.
        displacement: Learned displacement of the unposed vertices, strength included, [..., V, 3] metres.
    """

    vertices: Array
    displacement: Array


class Geometry(NamedTuple, Generic[Array]):
    """Placed Gaussians without opacity and color.

    Attributes:
        means: [..., N, 3] metres.
        quats: [..., N, 4] unit wxyz.
        scales: [..., N, 3] metres.
    """

    means: Array
    quats: Array
    scales: Array


def depth_range(depth: Array, alpha: Array) -> Array:
    """Smallest and largest depth of covered pixels.

    Args:
        depth: Expected depth, metres, [H, W].
        alpha: [H, W].

    Returns:
        [2] metres; zeros where nothing is covered.
    """
    covered = depth[alpha > COVERED]
    if not len(covered):
        return zeros((2,), depth)
    result: Array = library_of(depth).stack([covered.min(), covered.max()])
    return result


def normalise_depth(depth: Array, alpha: Array, limits: Array) -> Array:
    """Min-max normalised depth (paper section 3.3), premultiplied by alpha.

    Args:
        depth: Metres, [H, W].
        alpha: [H, W].
        limits: Smallest and largest depth, metres, [2] or [2, H, W].

    Returns:
        0 (near) to 1 (far) times alpha, [H, W].
    """
    clip = library_of(depth).clip
    span = clip(limits[1] - limits[0], _DEPTH_SPAN_MIN, None)
    result: Array = clip((depth - limits[0]) / span, 0.0, 1.0) * alpha
    return result


def refinement_grid(config: GRMMConfig) -> int:
    """Pixels that the sides of a refined picture are multiples of."""
    return config.refine_unshuffle << (len(config.refine_channels) - 1)


def refinement_margin(config: GRMMConfig) -> int:
    """Pixels beyond a pixel that its refined value can depend on, rounded up to the network's grid."""
    fold, levels = config.refine_unshuffle, len(config.refine_channels)
    # In cells of the finest level: one each for the first and the last convolution; at each level one of its cells on the
    # way down, one on the way up and two where nearest enlargement smears the next level; one at the bottom.
    reach = 2 + sum(4 << level for level in range(levels - 1)) + (1 << (levels - 1))
    grid = refinement_grid(config)
    return -(-reach * fold // grid) * grid


def face_mask(head: HeadModel) -> np.ndarray:
    """M_face of eq. 11: 0 on teeth vertices, 1 elsewhere, [V] float32."""
    return 1.0 - head.marked(*TEETH_REGIONS).astype(np.float32)
