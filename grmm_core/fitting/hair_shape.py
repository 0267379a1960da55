"""Hair that reaches as far as in the photos: a groom bent by a smooth field.

The field is a lattice of displacements around the mean head, found by gradient descent through the rasteriser: the drawn
cover must be the photos', coarsely and finely, so that hair far from where it should be is drawn there, too, and strands lie
along those of the photos, at little change of their lengths and bends. The root of a strand stays, what is further along it
follows more. So short hair cannot leave the head, a bob swells to the outline that the photo shows, a fringe comes down over
the forehead and is swept to the side. Imports torch.
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
from ..hair.ribbons import Eye
from ..hair.strands import lengthened
from ..photo.widening import widened
from ..splat.api import rasterize
from ..splat.types import Gaussians
from .adam import Adam
from .hair_grain import Directions

if TYPE_CHECKING:
    from ..head import HeadModel

LOW, HIGH = np.array([-0.2, -0.25, -0.2]), np.array([0.2, 0.25, 0.2])  # metres of the mean head: corners of the lattice
# metres along short and long strands from which on they follow the field wholly, and how long these are: short hair lies on the
# head, long hair falls from its parting at once and leaves no ditch there
FOLLOWS, REACHES = (0.05, 0.02), (0.08, 0.16)
LEVELS = ((1, 1.0), (5, 2.0), (15, 2.0))  # px over which cover is averaged, and what that counts
SMALL = 0.004  # weight of a field's length beside its curvature, in centimetres
TURNED = 1.0  # of strands that lie across the photo's, beside wrong cover
STRETCHED, KINKED = 2.0, 4.0  # of the squared changes of a segment's length, as a share of it, and of its angle to the next one
SHORTEST, FLAT = 1e-3, 1e-4  # metres of a segment, and px^2 of its length on a picture, from which on these are believed
NEAREST = 1e-3  # metres before a camera
UNCLEAR = 1e-12  # of a direction's squared length: where nothing is drawn it has no gradient
NEAR, SKIN = 2, 0.15  # px around a root that must show skin, and of how much hair that is
MOST_BARE = 0.2  # of the strands: if more seem to stand on skin, the photo is not to be believed
BEHIND = 0.004  # metres below the skin that are still seen


class Lattice(NamedTuple):
    """How a field is sought.

    Attributes:
        nodes: Along x, y, z.
        steps: Of the descent.
        rate: Of these, metres.
        smooth: Weight of the field's curvature, in centimetres, beside the share of wrong cover.
        depth: Factor of its curvature from front to back, which photos hardly tell: from the side hair had peaks and lumps.
    """

    nodes: tuple[int, int, int]
    steps: int
    rate: float
    smooth: float
    depth: float


COARSE = (Lattice((9, 11, 9), 20, 0.0045, 0.6, 2.0), Lattice((17, 21, 17), 20, 0.0025, 6.0, 2.0))
"""For few strands that stand for all: one after the other."""
FINE = (Lattice((17, 21, 17), 28, 0.00225, 1.5, 4.0),)
"""For strands about as thin as they are drawn: few and wide ones reach farther than these, by half their width."""


class Seen(Protocol):
    """What is used of a photo at small size: pictures [H, W]."""

    camera: Camera
    vertices: np.ndarray
    counts: np.ndarray
    hair: np.ndarray
    depth: np.ndarray
    seen: Directions


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


def field_to(course: Course, photos: Sequence[Seen], lattices: Sequence[Lattice] = COARSE) -> Tensor:
    """Find the displacements [3, Z, Y, X] in metres on the last lattice with which strands cover what photos show as hair.

    Along the strands' directions there, where they are clear.
    """
    field = torch.zeros(3, *lattices[0].nodes[::-1])
    share = torch.from_numpy(_share(course.rest))[..., None]
    rest, radii, *others = (
        torch.from_numpy(np.ascontiguousarray(part, np.float32))
        for part in (course.rest, course.radii, *course.posed, *course.turns)
    )
    posed, turns = others[: len(photos)], others[len(photos) :]
    wanted = [_Wanted.of(photo) for photo in photos]
    for nodes, steps, rate, *stiff in lattices:
        start = functional.interpolate(field[None], nodes[::-1], mode="trilinear", align_corners=True)[0]
        field = start.detach().requires_grad_(True)
        descent = Adam([{"params": [field], "lr": rate}])
        for _ in range(steps):
            descent.zero_grad()
            moved = share * _sampled(field, course.rest)
            loss = _roughness(field, *stiff) + _deformation(rest, moved)
            for photo, points, turn, target in zip(photos, posed, turns, wanted, strict=True):
                loss = loss + target.missed(*_drawn(points + moved @ turn, radii, course.opacity, photo)) / len(photos)
            loss.backward()
            descent.step()
    return field.detach()


class _Wanted(NamedTuple):
    """What strands shall look like in a photo.

    Attributes:
        hair: Cover, [H, W].
        counts: How much pixels count, [H, W].
        seen: Cosine and sine of twice the angle of strands, [H, W, 2].
        clear: How clear that is, [H, W].
        area: Of the hair, pixels.
        means: For each of `LEVELS` what makes the means over its squares of rows [H, H] and of columns [W, W].
    """

    hair: Tensor
    counts: Tensor
    seen: Tensor
    clear: Tensor
    area: Tensor
    means: list[tuple[Tensor, Tensor]]

    @staticmethod
    def of(photo: Seen) -> _Wanted:
        """Of a photo."""
        hair, counts, *ways = (
            torch.from_numpy(np.asarray(part, np.float32)) for part in (photo.hair, photo.counts, *photo.seen)
        )
        seen = torch.stack(ways, -1)
        means = [(_banded(len(hair), size), _banded(hair.shape[1], size)) for size, _ in LEVELS]
        return _Wanted(hair, counts, seen, seen.norm(dim=-1), (hair * counts).sum().clamp_min(1.0), means)

    def missed(self, cover: Tensor, way: Tensor) -> Tensor:
        """How far a drawn cover [H, W] and directions [H, W, 2] are off, as a share of the hair, []."""
        off = (cover - self.hair) * self.counts
        loss = off.new_zeros(())
        for (size, weight), (rows, columns) in zip(LEVELS, self.means, strict=True):
            wide = off if size == 1 else rows @ off @ columns
            loss = loss + weight * wide.square().sum()
        across = self.clear * (way.square().sum(-1) + UNCLEAR).sqrt() - (self.seen * way).sum(-1)
        return (loss + TURNED * (across * self.counts).sum()) / self.area


def _banded(count: int, size: int) -> Tensor:
    """What makes of `count` values in a row the mean of `size`, an odd number, around each; zeros beyond the ends."""
    return torch.ones(count, count).triu(-(size // 2)).tril(size // 2) / size


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
    along = np.cumsum(np.linalg.norm(np.diff(strands, axis=1, prepend=strands[:, :1]), axis=2), 1)
    share: np.ndarray = np.minimum(along / np.interp(along[:, -1:], REACHES, FOLLOWS), 1.0).astype(np.float32)
    return share


def _sampled(field: Tensor, points: np.ndarray) -> Tensor:
    """The field at points [N, K, 3] of the mean head, [N, K, 3]."""
    place = torch.from_numpy((2.0 * (points - LOW) / (HIGH - LOW) - 1.0).astype(np.float32))
    found = functional.grid_sample(field[None], place[None, None], padding_mode="border", align_corners=True)
    return found[0, :, 0].permute(1, 2, 0)


def _roughness(field: Tensor, smooth: float, depth: float) -> Tensor:
    """What a field costs by itself."""
    bends = [100.0 * factor * field.diff(2, axis) for axis, factor in enumerate((depth, 1.0, 1.0), 1)]
    bent: Tensor = sum(((part**2).mean() for part in bends), SMALL / smooth * ((100.0 * field) ** 2).mean())
    return smooth * bent


def _deformation(rest: Tensor, moved: Tensor) -> Tensor:
    """What it costs that strands [N, K, 3] are longer or shorter than they were, and bent otherwise."""
    lengths = rest.diff(dim=1).norm(dim=2).clamp_min(SHORTEST)
    stretched = (rest + moved).diff(dim=1).norm(dim=2) / lengths - 1.0
    bends = moved.diff(n=2, dim=1).square().sum(2) / lengths[:, 1:].square()
    return STRETCHED * stretched.square().mean() + KINKED * bends.mean()


def _drawn(points: Tensor, radii: Tensor, opacity: float, photo: Seen) -> tuple[Tensor, Tensor]:
    """What strands [N, K, 3] cover of a photo, [H, W], and cosine and sine of twice their angles there, [H, W, 2]."""
    camera = photo.camera
    made = strand_segments(points.contiguous(), radii, points.new_full((len(points),), opacity), Eye.of(camera))
    means = made.means.reshape(-1, 3)
    local, pixels = camera.project(means.detach().numpy())
    column, row = (np.clip(pixels[:, k].astype(int), 0, size - 1) for k, size in ((0, camera.width), (1, camera.height)))
    shown = torch.from_numpy((local[:, 2] < photo.depth[row, column] + BEHIND).astype(np.float32))
    gaussians = Gaussians(
        means,
        made.quats.reshape(-1, 4),
        made.scales.reshape(-1, 3),
        made.opacities.reshape(-1) * shown,
        _angles(points, camera),
    )
    picture = rasterize(gaussians, camera)
    return picture.alpha, picture.rgb[..., :2]


def _angles(points: Tensor, camera: Camera) -> Tensor:
    """Cosine and sine of twice the angle of segments of strands [N, K, 3] on a picture, and 0, [N * (K - 1), 3]."""
    place = torch.from_numpy(camera.world_to_camera.astype(np.float32))
    local = points @ place[:3, :3].T + place[:3, 3]
    flat = local[..., :2] * local.new_tensor([camera.fx, camera.fy])
    if not camera.orthographic:
        flat = flat / local[..., 2:].clamp_min(NEAREST)
    x, y = flat.diff(dim=1).reshape(-1, 2).unbind(1)
    squared = x * x + y * y + FLAT
    return torch.stack([(x * x - y * y) / squared, 2.0 * x * y / squared, torch.zeros_like(x)], 1)
