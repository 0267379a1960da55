"""Linear blend skinning as pure functions, for numpy arrays and torch tensors alike.

The functions use only operators that both libraries share, picked by the type of the argument, so that the animation path
(numpy, stock Blender) and the training path (torch, batched, differentiable) are one text. Torch is never imported here.
Used by `head.head_model`, `head.torch_head` and the builder of the open head.

Conventions: rotation matrices in head axes (`geometry.rotations.euler_to_matrix` gives them); lengths in metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.libraries import Array, library_of


def joint_transforms(rotations: Array, joints: Array, parents: Sequence[int]) -> Array:
    """Chain the joints' rotations: transforms that take rest positions to posed positions.

    Args:
        rotations: Rotation of each joint relative to its parent, [..., J, 3, 3].
        joints: Rest positions in metres, [..., J, 3].
        parents: Parent of each joint, -1 for the root; parents come before children.

    Returns:
        Affine transforms, [..., J, 3, 4].
    """
    lib = library_of(rotations)
    turned: list[Array] = []  # [..., 3, 3] each
    shifted: list[Array] = []  # [..., 3] each: x -> turned x + shifted
    for j, parent in enumerate(parents):
        rotation, joint = rotations[..., j, :, :], joints[..., j, :]
        # about its rest position, then as the parent moves
        local = joint - (rotation @ joint[..., None])[..., 0]
        if parent < 0:
            turned.append(rotation)
            shifted.append(local)
        else:
            turned.append(turned[parent] @ rotation)
            shifted.append((turned[parent] @ local[..., None])[..., 0] + shifted[parent])
    columns = [lib.concatenate((r, t[..., None]), -1) for r, t in zip(turned, shifted, strict=True)]
    return lib.stack(columns, -3)


def skin(vertices: Array, transforms: Array, weights: Array) -> Array:
    """Linear blend skinning.

    Args:
        vertices: Unposed positions in metres, [..., V, 3].
        transforms: [..., J, 3, 4] of `joint_transforms`.
        weights: Skinning weights, rows sum to 1, [V, J].

    Returns:
        Posed positions, [..., V, 3].
    """
    flat = transforms.reshape((*transforms.shape[:-2], 12))  # [..., J, 12]
    blended = (weights @ flat).reshape((*transforms.shape[:-3], weights.shape[0], 3, 4))  # [..., V, 3, 4]
    # three products of columns: much faster than many small matrix products
    columns = [blended[..., k] * vertices[..., k : k + 1] for k in range(3)]
    return columns[0] + columns[1] + columns[2] + blended[..., 3]


def posed_vertices(
    vertices: Array, rotations: Array, joints: Array, weights: Array, parents: Sequence[int], posedirs: Array | None = None
) -> Array:
    """Pose-corrective directions where the model has them, then linear blend skinning (FLAME's order).

    Args:
        vertices: Template plus shape, expression and displacement, [..., V, 3].
        rotations: [..., J, 3, 3].
        joints: Rest joints of the shaped head, [..., J, 3].
        weights: [V, J].
        parents: As for `joint_transforms`.
        posedirs: Offsets per entry of (R_j - I) of all joints but the root, [V, 3, 9 (J - 1)], or None.

    Returns:
        [..., V, 3].
    """
    if posedirs is not None:
        lib = library_of(rotations)
        identity = (
            np.eye(3) if isinstance(rotations, np.ndarray) else lib.eye(3, dtype=rotations.dtype, device=rotations.device)
        )
        feature = (rotations[..., 1:, :, :] - identity).reshape((*rotations.shape[:-3], -1))  # [..., 9 (J - 1)]
        vertices = vertices + lib.einsum("vip,...p->...vi", posedirs, feature)
    return skin(vertices, joint_transforms(rotations, joints, parents), weights)
