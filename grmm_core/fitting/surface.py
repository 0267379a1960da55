"""The texels of a model as a surface: parts of the head, neighbours, mirror images; and filling in what no photo shows.

Parts: skin, scalp (where Gaussians have hair) and the inner parts (eyes, teeth, tongue, mouth, lashes), whose colors a photo's
skin says nothing about. `fill` spreads values from texels that a photo shows to those that none does, along the surface and
across the plane of symmetry: the membrane of least bending by conjugate gradients.

Called by `recoloring` and `decoder_stage`. Imports torch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..compute.recent import Recent
from ..geometry.libraries import to_numpy
from ..head import HeadModel
from ..model.grmm import GRMM
from ..model.sparse import FixedSparse
from .chin import below_chin

SKIN, SCALP, INNER = range(3)
GROUPS = 3
INNER_REGIONS = (
    "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "mouth_interior", "lashes",
)  # fmt: skip
LIPS, TEETH, INSIDE, BROWS = ("lips",), ("upper_teeth", "lower_teeth"), ("tongue", "mouth_interior"), ("brows",)
SEAM_REACH = 0.004  # metres on the mean head between texels at the borders of the UV map's islands
BESIDE = (0.045, 0.06)  # metres from the plane of symmetry: eyes and mouth are before the first, brows before the second
BESIDE_CHIN = (0.025, 0.04)  # likewise below the lips, where the face is narrower
UNDER_LIPS = (0.0, 0.008)  # metres below the lips: above the first the face is wide, below the second narrow
LIP_RIM = (0.003, 0.009)  # metres from the lips: skin nearer than the first is at their rim, beyond the second not
MIRROR_REACH = 0.005  # metres; the mean head is nearly symmetric
MIRROR_WEIGHT = 0.25  # of a link across the plane of symmetry; a neighbour has 1
SEEN_WEIGHT = 40.0  # of a fully seen texel's own value
REST_WEIGHT = 0.004  # pulls unseen texels to zero: far from everything seen the prior stands
_ITERATIONS, _TOLERANCE = 80, 2e-3
_CHUNK = 1024


@dataclass(frozen=True)
class Surface:
    """Texels of a model.

    Attributes:
        group: `SKIN`, `SCALP` or `INNER`, [N].
        links: Adjacency of neighbours, and of neighbours and mirror images: weights w, [N, N] sparse and symmetric.
        degrees: Row sums of both, [2, N].
        average: Mean of each texel and its neighbours, [N, N] sparse.
        beside: How far it is beside the face's features or below the chin, 0..1, [N].
        below: How far below the chin, 0..1, [N] (`chin.below_chin`).
        lips: Whether it is of the lips, [N].
        teeth: Whether it is of the teeth, [N].
        inside: Whether it is of the tongue or the mouth around it, [N].
        lip_rim: How near skin is to the lips, 0..1, [N]; 0 on the lips.
        brows: Whether it is of the brows, [N].
    """

    group: Tensor
    links: tuple[FixedSparse, FixedSparse]
    degrees: Tensor
    average: FixedSparse
    beside: Tensor
    below: Tensor
    lips: Tensor
    teeth: Tensor
    inside: Tensor
    lip_rim: Tensor
    brows: Tensor

    @property
    def skin(self) -> Tensor:
        """Whether texels are skin or lips, [N]."""
        return self.group == SKIN

    @property
    def membership(self) -> Tensor:
        """One column a group, [N, 3] of 0 and 1."""
        return torch.nn.functional.one_hot(self.group, GROUPS).to(self.degrees.dtype)

    def fill(self, values: Tensor, seen: Tensor, mirrored: bool = True, rest: float = REST_WEIGHT) -> Tensor:
        """Minimise sum_i a s_i (x_i - v_i)^2 + sum_links w (x_i - x_j)^2 + r sum_i x_i^2.

        Args:
            values: v, [N, C].
            seen: s, 0..1: how well each is known, [N].
            mirrored: Use the links across the plane of symmetry.
            rest: r.

        Returns:
            x, [N, C].
        """
        links, degree = self.links[int(mirrored)], self.degrees[int(mirrored)][:, None]
        known = SEEN_WEIGHT * seen[:, None]
        diagonal = known + degree + rest
        start = values * (known / diagonal)
        return _conjugate_gradients(lambda x: diagonal * x - links(x), known * values, start, diagonal)

    def smooth(self, values: Tensor, texels: float) -> Tensor:
        """Values [N, C] smoothed along the surface over some texels (the membrane's length of decay)."""
        weight = 1.0 / texels**2
        diagonal = weight + self.degrees[0][:, None]
        links = self.links[0]
        return _conjugate_gradients(lambda x: diagonal * x - links(x), weight * values, values, diagonal)


def texel_surface(model: GRMM) -> Surface:
    """Find parts and links of a model's texels on the mean head; tracking and fitting ask for the same model's."""
    anchor, config = model.anchor, model.config
    texels = (to_numpy(part) for part in (anchor.face, anchor.barycentric, anchor.texel))
    key = model.head_model, anchor.grid, *texels, config.hairless, model.dtype, model.device
    return _SURFACES.get(key, lambda: _found(model))


_SURFACES: Recent[Surface] = Recent(1)


def _found(model: GRMM) -> Surface:
    head, grid = model.head_model, model.anchor.grid
    faces = head.faces[model.anchor.face.cpu().numpy()]  # [N, 3]
    barycentric = model.anchor.barycentric.cpu().numpy()
    nearest = faces[np.arange(len(faces)), barycentric.argmax(1)]
    positions = np.einsum("nk,nkx->nx", barycentric, head.v_template[faces]).astype(np.float32)
    group, part = _parts(head, nearest)
    if model.config.hairless:  # a scalp is skin
        group[group == SCALP] = SKIN
    near, border = _grid_links(model.anchor.texel.cpu().numpy(), grid, part, positions)
    seams = _nearest(positions, border, border, part, SEAM_REACH)
    everything = np.arange(len(positions))
    # left and right parts (eyeballs) are one part here
    mirror = _nearest(positions, everything, everything, group, MIRROR_REACH, flip=True)
    plain = np.concatenate([near, seams], 1)
    both = np.concatenate([plain, mirror], 1)
    weights = np.concatenate([np.ones(plain.shape[1]), np.full(mirror.shape[1], MIRROR_WEIGHT)])
    count = len(positions)
    matrices, degrees = [], []
    for edges, weight in ((plain, weights[: plain.shape[1]]), (both, weights)):
        rows, columns, values = np.concatenate([edges[0], edges[1]]), np.concatenate([edges[1], edges[0]]), np.tile(weight, 2)
        matrices.append(FixedSparse((rows, columns, values), (count, count)).to(model.device))
        degrees.append(np.bincount(rows, values, count))
    below = (barycentric * below_chin(head)[faces]).sum(1)
    lips, teeth, inside, brows = (head.marked(*part)[faces].all(1) for part in (LIPS, TEETH, INSIDE, BROWS))
    near_lips = _near_lips(positions, lips) * (group == SKIN)
    beside = np.maximum(_beside(head, positions), below)
    shares = torch.tensor(np.stack([beside, below, near_lips]), dtype=model.dtype, device=model.device)
    own = torch.tensor(np.stack([lips, teeth, inside, brows]), device=model.device)
    return Surface(
        torch.tensor(group, dtype=torch.int64, device=model.device), (matrices[0], matrices[1]),
        torch.tensor(np.stack(degrees), dtype=model.dtype, device=model.device), _average(plain, count).to(model.device),
        shares[0], shares[1], own[0], own[1], own[2], shares[2], own[3],
    )  # fmt: skip


def _near_lips(positions: np.ndarray, lips: np.ndarray) -> np.ndarray:
    """How near points of the mean head [N, 3] are to those of the lips, 0..1 [N]; 0 for these."""
    near = np.zeros(len(positions))
    if not lips.any():
        return near
    low, high = positions[lips].min(0) - LIP_RIM[1], positions[lips].max(0) + LIP_RIM[1]
    rows = np.flatnonzero(((positions > low) & (positions < high)).all(1) & ~lips)
    far = torch.cdist(torch.from_numpy(positions[rows]), torch.from_numpy(positions[lips])).amin(1).numpy()
    near[rows] = np.interp(far, LIP_RIM, (1.0, 0.0))
    return near


def _beside(head: HeadModel, positions: np.ndarray) -> np.ndarray:
    """How far points of the mean head [N, 3] are beside eyes, mouth and chin, 0..1 [N]."""
    lateral = np.abs(positions[:, 0])
    beside = np.interp(lateral, BESIDE, (0.0, 1.0))
    if "lips" in head.regions:
        lower = head.v_template[head.regions["lips"], 1].min() - positions[:, 1]
        chin = np.interp(lower, UNDER_LIPS, (0.0, 1.0))
        beside = (1.0 - chin) * beside + chin * np.interp(lateral, BESIDE_CHIN, (0.0, 1.0))
    return beside


def _average(edges: np.ndarray, count: int) -> FixedSparse:
    """Mean over a texel and its neighbours."""
    own = np.arange(count)
    rows, columns = np.concatenate([own, edges[0], edges[1]]), np.concatenate([own, edges[1], edges[0]])
    return FixedSparse((rows, columns, 1.0 / np.bincount(rows, minlength=count)[rows]), (count, count))


def _parts(head: HeadModel, vertex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group and part number of texels by their nearest vertex, both [N]."""
    group, part = np.full(head.vertex_count, SKIN), np.zeros(head.vertex_count, np.int64)
    if "scalp" in head.regions:
        group[head.regions["scalp"]] = SCALP  # hair and skin blend: one part
    for number, name in enumerate(INNER_REGIONS):
        if name in head.regions:
            group[head.regions[name]], part[head.regions[name]] = INNER, number + 1
    return group[vertex], part[vertex]


def _grid_links(texel: np.ndarray, grid: int, part: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Links of texels that touch in the UV map and on the head, [2, L], and the texels that lack such a neighbour."""
    number = np.full((grid + 1, grid + 1), -1, np.int64)
    row, column = texel // grid, texel % grid
    number[row, column] = np.arange(len(texel))
    count = np.zeros(len(texel), np.int64)
    links = []
    for down, right in ((0, 1), (1, 0)):
        other = number[row + down, column + right]
        own = np.flatnonzero(other >= 0)
        other = other[own]
        # islands of different parts can touch in the packed map
        close = (part[own] == part[other]) & (np.abs(positions[own] - positions[other]).max(1) < 2 * SEAM_REACH)
        own, other = own[close], other[close]
        links.append(np.stack([own, other]))
        np.add.at(count, own, 1)
        np.add.at(count, other, 1)
    return np.concatenate(links, 1), np.flatnonzero(count < 4)


def _nearest(
    positions: np.ndarray, rows: np.ndarray, columns: np.ndarray, label: np.ndarray, reach: float, flip: bool = False
) -> np.ndarray:
    """Links from some texels to the nearest of others (mirrored: of their mirror image) with the same label, [2, L].

    Texels are sorted by height, so that each chunk is compared with a slab only: no tree needed.
    """
    points = positions * np.array([-1.0 if flip else 1.0, 1.0, 1.0], np.float32)
    rows, columns = rows[np.argsort(points[rows, 1])], columns[np.argsort(positions[columns, 1])]
    heights = positions[columns, 1]
    found: list[np.ndarray] = []
    for start in range(0, len(rows), _CHUNK):
        own = rows[start : start + _CHUNK]
        low, high = np.searchsorted(heights, (points[own[0], 1] - reach, points[own[-1], 1] + reach))
        slab = columns[low:high]
        if not len(slab):
            continue
        distance = torch.cdist(torch.from_numpy(points[own]), torch.from_numpy(positions[slab]))
        other = torch.from_numpy(label[own][:, None] != label[slab][None])
        if not flip:  # across a seam, not the neighbour on the same side of it
            other |= distance < 1e-9
        shortest, place = distance.masked_fill_(other, torch.inf).min(1)
        close = shortest.numpy() < reach
        found.append(np.stack([own[close], slab[place.numpy()[close]]]))
    return np.concatenate(found, 1).astype(np.int64) if found else np.zeros((2, 0), np.int64)


def _conjugate_gradients(apply: Callable[[Tensor], Tensor], right: Tensor, start: Tensor, diagonal: Tensor) -> Tensor:
    """Solve A x = right for each column, Jacobi-preconditioned, until the residual is small or the iterations are used up."""
    x = start.clone()
    residual = right - apply(x)
    direction = scaled = residual / diagonal
    old = (residual * scaled).sum(0)
    enough = old * _TOLERANCE**2
    for _ in range(_ITERATIONS):
        if bool((old <= enough).all()):
            break
        image = apply(direction)
        step = old / (direction * image).sum(0).clamp(min=1e-20)
        x = x + step * direction
        residual = residual - step * image
        scaled = residual / diagonal
        new = (residual * scaled).sum(0)
        direction = scaled + (new / old.clamp(min=1e-20)) * direction
        old = new
    return x
