"""Hair that reaches as far as in the photos: a groom bent by a smooth field.

The field is a lattice of displacements around the mean head, found by gradient descent through the rasteriser: the drawn
cover must be the photos', coarsely and finely, so that hair far from where it should be is drawn there, too. The root of a
strand stays, what is further along it follows more. So short hair cannot leave the head, a bob swells to the outline that the
photo shows, and a fringe comes down over the forehead. Imports torch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..geometry.camera import Camera
from ..hair.body import Body
from ..hair.gradients import strand_segments
from ..hair.groom import Groom, bind
from ..hair.strands import lengthened
from ..photo.widening import widened
from ..splat.api import rasterize
from ..splat.types import Gaussians

if TYPE_CHECKING:
    from ..head import HeadModel

LOW, HIGH = np.array([-0.2, -0.25, -0.2]), np.array([0.2, 0.25, 0.2])  # metres of the mean head: corners of the lattice
NODES = (9, 11, 9), (17, 21, 17)  # a coarse lattice first, then a fine one
FOLLOWS = 0.05  # metres along a strand from which on it follows the field wholly
STEPS, RATES = (32, 24), (0.0035, 0.002)  # of the descent on each; metres
LEVELS = ((1, 1.0), (5, 2.0), (15, 2.0))  # px over which cover is averaged, and what that counts
# weights of a field's curvature on each lattice and of its length, in centimetres, beside the share of wrong cover
SMOOTH, SMALL = (0.6, 6.0), 0.004
NEAR, SKIN = 2, 0.15  # px around a root that must show skin, and of how much hair that is
MOST_BARE = 0.2  # of the strands: if more seem to stand on skin, the photo is not to be believed
BEHIND = 0.004  # metres below the skin that are still seen


class Seen(Protocol):
    """What is used of a photo at small size: pictures [H, W]."""

    camera: Camera
    vertices: np.ndarray
    counts: np.ndarray
    hair: np.ndarray
    depth: np.ndarray


class Course(NamedTuple):
    """Strands of a groom that stand for all of it.

    Attributes:
        rest: On the mean head, metres, [N, K, 3].
        posed: On the head of each photo.
        turns: From the axes of the mean head to those of each photo, as rows, [N, 3, 3].
        radii: Half the diameters, [N, 2].
        opacity: Of a strand.
    """

    rest: np.ndarray
    posed: Sequence[np.ndarray]
    turns: Sequence[np.ndarray]
    radii: np.ndarray
    opacity: float


def field_to(course: Course, photos: Sequence[Seen]) -> Tensor:
    """Find the displacements [3, Z, Y, X] in metres on the lattice with which strands cover what the photos show as hair."""
    field = torch.zeros(3, *NODES[0][::-1])
    share = torch.from_numpy(_share(course.rest))[..., None]
    radii = torch.from_numpy(np.ascontiguousarray(course.radii, np.float32))
    posed = [torch.from_numpy(np.ascontiguousarray(part, np.float32)) for part in course.posed]
    turns = [torch.from_numpy(np.ascontiguousarray(part, np.float32)) for part in course.turns]
    wanted = [torch.from_numpy(np.stack([photo.hair, photo.counts]).astype(np.float32)) for photo in photos]
    for nodes, steps, rate, smooth in zip(NODES, STEPS, RATES, SMOOTH, strict=True):
        start = functional.interpolate(field[None], nodes[::-1], mode="trilinear", align_corners=True)[0]
        field = start.detach().requires_grad_(True)
        descent = torch.optim.Adam([field], rate)
        for _ in range(steps):
            descent.zero_grad()
            moved = share * _sampled(field, course.rest)
            loss = _roughness(field, smooth)
            for photo, points, turn, (hair, counts) in zip(photos, posed, turns, wanted, strict=True):
                cover = _cover(points + moved @ turn, radii, course.opacity, photo)
                off = ((cover - hair) * counts)[None, None]
                area = (hair * counts).sum().clamp_min(1.0) * len(photos)
                for size, weight in LEVELS:
                    loss = loss + weight * (functional.avg_pool2d(off, size, 1, size // 2) ** 2).sum() / area
            loss.backward()
            descent.step()
    return field.detach()


def offsets(field: Tensor, strands: np.ndarray) -> np.ndarray:
    """How far a field moves strands of the mean head, [N, K, 3]."""
    moved: np.ndarray = _share(strands)[..., None] * _sampled(field, strands).numpy()
    return moved


def bent(groom: Groom, length: float, field: Tensor, head: HeadModel) -> Groom:
    """A groom of scalp hair of so many times the length, moved by a field, outside of the mean head."""
    vertices, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    count = int(groom.counts.max())
    even = groom.resampled(count)
    origin, axes = even.frames(vertices, faces).at(vertices)
    strands = np.matmul(lengthened(even.points.reshape(len(even), count, 3), length), axes) + origin[:, None]
    points = Body.of(head, vertices).pushed(strands + offsets(field, strands)).reshape(-1, 3).astype(np.float64)
    return bind(vertices, faces, vertices, even.triangles, even.weights, points, even.offsets, even.widths, even.groups)


def with_hairline(groom: Groom, photos: Sequence[Seen], head: HeadModel) -> Groom:
    """A groom without the strands whose roots a photo shows on bare skin; the whole groom where that would be too many."""
    origins = groom.frames(np.asarray(head.v_template, np.float64), head.faces)
    bare = np.zeros(len(groom), bool)
    for photo in photos:
        roots = origins.at(photo.vertices)[0]
        local, pixels = photo.camera.project(roots)
        inside = ((pixels >= 0) & (pixels < (photo.camera.width, photo.camera.height))).all(1)
        column, row = (np.clip(pixels[:, k].astype(int), 0, size - 1) for k, size in enumerate(photo.hair.shape[::-1]))
        planes = torch.from_numpy(np.stack([photo.hair, 1.0 - photo.counts]).astype(np.float32))
        near = widened(planes, NEAR).amax(0).numpy()
        bare |= inside & (local[:, 2] < photo.depth[row, column] + BEHIND) & (near[row, column] < SKIN)
    return groom if bare.mean() > MOST_BARE else groom.select(~bare)


def _share(strands: np.ndarray) -> np.ndarray:
    """How much of the field each point [N, K, 3] follows, [N, K]."""
    steps = np.linalg.norm(np.diff(strands, axis=1, prepend=strands[:, :1]), axis=2)
    share: np.ndarray = np.minimum(np.cumsum(steps, 1) / FOLLOWS, 1.0).astype(np.float32)
    return share


def _sampled(field: Tensor, points: np.ndarray) -> Tensor:
    """The field at points [N, K, 3] of the mean head, [N, K, 3]."""
    place = torch.from_numpy((2.0 * (points - LOW) / (HIGH - LOW) - 1.0).astype(np.float32))
    found = functional.grid_sample(field[None], place[None, None], padding_mode="border", align_corners=True)
    return found[0, :, 0].permute(1, 2, 0)


def _roughness(field: Tensor, smooth: float) -> Tensor:
    """What a field costs by itself."""
    bends = [100.0 * field.diff(2, axis) for axis in (1, 2, 3)]
    bent: Tensor = sum(((part**2).mean() for part in bends), SMALL / smooth * ((100.0 * field) ** 2).mean())
    return smooth * bent


def _cover(points: Tensor, radii: Tensor, opacity: float, photo: Seen) -> Tensor:
    """What strands [N, K, 3] cover of a photo, [H, W]."""
    camera = photo.camera
    made = strand_segments(points.contiguous(), radii, points.new_full((len(points),), opacity))
    means = made.means.reshape(-1, 3)
    local, pixels = camera.project(means.detach().numpy())
    column, row = (np.clip(pixels[:, k].astype(int), 0, size - 1) for k, size in ((0, camera.width), (1, camera.height)))
    shown = torch.from_numpy((local[:, 2] < photo.depth[row, column] + BEHIND).astype(np.float32))
    gaussians = Gaussians(
        means,
        made.quats.reshape(-1, 4),
        made.scales.reshape(-1, 3),
        made.opacities.reshape(-1) * shown,
        torch.zeros_like(means),
    )
    return rasterize(gaussians, camera).alpha
