"""Gaussians in world space as arrays: placing, packing for textures, sorting. Plain numpy; knows no Blender.

A texel is four floats; a Gaussian takes three: centre and two packed colors, four of the covariance, two of the covariance, the
packed rest and whether it is antialiased. Two values of 12 bits share a float, which holds 24 bits exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grmm_core.geometry.camera import Camera

TEXTURE_WIDTH = 2048  # texels in a row; every card has textures of this size
TEXELS = 3  # of a Gaussian
MAX_GAUSSIANS = 4_000_000  # in one viewport; more are thinned out evenly
PACK_STEPS = 4095  # 12 bits
_PACK_BASE = 4096
_BITS = 16  # sorted at once: numpy sorts 16-bit integers by radix


Part = tuple[float, float, float, float]
"""A rectangle of a picture: left, lower, right and upper edge as shares of its width and height."""
WHOLE: Part = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Picture:
    """What the CPU rasteriser made for a part of a viewport, smaller than it.

    Attributes:
        color: Display RGBA, premultiplied, [H, W, 4] float32, top row first.
        depth: Camera z in metres, 0 where nothing is, [H, W] float32.
        frame: The part of the viewport.
    """

    color: np.ndarray
    depth: np.ndarray
    frame: Part = WHOLE

    @property
    def is_cut(self) -> bool:
        """Whether it ends where something is, inside the viewport."""
        edges = self.depth[:, 0], self.depth[-1], self.depth[:, -1], self.depth[0]
        return any(edge.any() and place != whole for edge, place, whole in zip(edges, self.frame, WHOLE, strict=True))

    @property
    def part(self) -> Part:
        """Where something is, a pixel wider."""
        rows, columns = (np.flatnonzero(self.depth.any(axis)) for axis in (1, 0))
        if not rows.size:
            return 0.0, 0.0, 0.0, 0.0
        height, width = self.depth.shape
        edges = (columns[0] - 1) / width, 1.0 - (rows[-1] + 2) / height, (columns[-1] + 2) / width, 1.0 - (rows[0] - 1) / height
        left, lower, right, upper = (float(min(max(edge, 0.0), 1.0)) for edge in edges)
        return left, lower, right, upper


@dataclass(frozen=True)
class WorldGaussians:
    """Gaussians in the world.

    Attributes:
        means: Centres in metres, [N, 3] float64.
        covariances: xx, xy, xz, yy, yz, zz in square metres, [N, 6] float32.
        colors: Display sRGB, [N, 3] float32.
        opacities: 0..1, [N] float32.
        antialiased: 1 where the opacity is compensated for the dilation (`splat.compensation`), else 0, [N] float32.
    """

    means: np.ndarray
    covariances: np.ndarray
    colors: np.ndarray
    opacities: np.ndarray
    antialiased: np.ndarray

    def __len__(self) -> int:
        return len(self.means)

    @staticmethod
    def place(
        means: np.ndarray,
        quats: np.ndarray,
        scales: np.ndarray,
        opacities: np.ndarray,
        colors: np.ndarray,
        model_to_world: np.ndarray,
        antialiased: bool = False,
    ) -> WorldGaussians:
        """Bring Gaussians from a model's space into the world; those with numbers that are not finite are left out.

        Args:
            means: [N, 3].
            quats: wxyz, any length but zero, [N, 4].
            scales: Standard deviations, [N, 3].
            opacities: [N].
            colors: [N, 3].
            model_to_world: Any affine placement, [4, 4].
            antialiased: Compensate all their opacities for the dilation.
        """
        linear = np.asarray(model_to_world, np.float64)[:3, :3]
        axes = (linear.astype(np.float32) @ _rotations(quats)) * scales[:, None, :]  # [N, 3, 3]
        covariance = axes @ axes.transpose(0, 2, 1)
        six = covariance.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
        world = means.astype(np.float64) @ linear.T + np.asarray(model_to_world, np.float64)[:3, 3]
        keep = np.isfinite(world).all(-1) & np.isfinite(six).all(-1) & np.isfinite(colors).all(-1) & np.isfinite(opacities)
        flags = np.full(len(world), antialiased, np.float32)
        if keep.all():
            return WorldGaussians(world, six, colors, opacities, flags)
        return WorldGaussians(world[keep], six[keep], colors[keep], opacities[keep], flags[keep])

    @staticmethod
    def concatenate(parts: list[WorldGaussians]) -> WorldGaussians:
        """Join several; they are then sorted together."""
        if len(parts) == 1:
            return parts[0]
        nothing = np.zeros(0, np.float32)
        empty = WorldGaussians(np.zeros((0, 3)), nothing.reshape(0, 6), nothing.reshape(0, 3), nothing, nothing)
        names = ("means", "covariances", "colors", "opacities", "antialiased")
        return WorldGaussians(*(np.concatenate([getattr(part, name) for part in (empty, *parts)]) for name in names))


@dataclass(frozen=True)
class Packed:
    """Gaussians as the shader reads them.

    Attributes:
        origin: What `offsets` are relative to, [3] float64: single precision would lose millimetres far from the world's
            origin.
        offsets: Centres, [N, 3] float32.
        texels: [rows, TEXTURE_WIDTH, 4] float32.
    """

    origin: np.ndarray
    offsets: np.ndarray
    texels: np.ndarray

    def __len__(self) -> int:
        return len(self.offsets)


def pack(gaussians: WorldGaussians) -> Packed:
    """Return Gaussians ready for the graphics card, at most `MAX_GAUSSIANS` of them."""
    step = -(-len(gaussians) // MAX_GAUSSIANS) or 1
    means, covariances = gaussians.means[::step], gaussians.covariances[::step]
    colors, opacities = gaussians.colors[::step], gaussians.opacities[::step]
    count = len(means)
    origin = means.mean(axis=0) if count else np.zeros(3)
    offsets = (means - origin).astype(np.float32)
    values = np.zeros((_rows(count * TEXELS) * TEXTURE_WIDTH, 4), np.float32)
    mine = values[: count * TEXELS].reshape(count, TEXELS, 4)
    levels = np.rint(np.clip(np.column_stack([colors, opacities]), 0.0, 1.0) * PACK_STEPS)  # [N, 4]
    mine[:, 0, :3] = offsets
    mine[:, 0, 3] = levels[:, 0] * _PACK_BASE + levels[:, 1]
    mine[:, 1] = covariances[:, :4]
    mine[:, 2, :2] = covariances[:, 4:]
    mine[:, 2, 2] = levels[:, 2] * _PACK_BASE + levels[:, 3]
    mine[:, 2, 3] = gaussians.antialiased[::step]
    return Packed(origin, offsets, values.reshape(-1, TEXTURE_WIDTH, 4))


def depth_order(packed: Packed, camera: Camera) -> np.ndarray:
    """Return the Gaussians' indices from the farthest to the nearest, as a texture [rows, TEXTURE_WIDTH] float32.

    Of equal depths the higher index is farther, as in the rasteriser.
    """
    count = len(packed)
    axis = camera.world_to_camera[2, :3].astype(np.float32)
    depth = packed.offsets @ axis
    # The bits of positive floats have the order of their values; the shift keeps the order and makes them positive.
    keys = (depth - depth.min(initial=0.0)).view(np.uint32)
    order = np.argsort((keys & 0xFFFF).astype(np.uint16), kind="stable")
    order = order[np.argsort((keys >> _BITS).astype(np.uint16)[order], kind="stable")]
    texture = np.zeros(_rows(count) * TEXTURE_WIDTH, np.float32)
    texture[:count] = order[::-1]
    return texture.reshape(-1, TEXTURE_WIDTH)


def _rows(texels: int) -> int:
    return max(1, -(-texels // TEXTURE_WIDTH))


def _rotations(quats: np.ndarray) -> np.ndarray:
    """Rotation matrices [N, 3, 3] of quaternions wxyz of any length."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=-1, keepdims=True)).astype(np.float32).T
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, -1).reshape(-1, 3, 3)
