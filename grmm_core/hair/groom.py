"""The record of a head's strands: where each is rooted, its points in the root's frame, its width, its group. Numpy only.

A `Groom` is made once, on a neutral head, and posed on any head of the same topology. Strands have any number of points each:
strand i owns the rows `offsets[i]` to `offsets[i + 1]` of `points`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ShapeError
from .roots import RootFrames

MAX_POINTS = 8_000_000
MAX_EXTENT = 2.0  # metres from the root
QUANTUM = 2.0e-5  # metres; of packed points
WIDEST = 6.0  # how much wider the strands of a coarse level may get
TINTS = 8  # places along a strand, evenly from root to tip, at which its own colors are known


@dataclass(frozen=True)
class Groom:
    """Strands bound to the triangles of a head.

    Attributes:
        triangles: Number of the head's triangle under each root, int32, [N].
        weights: Barycentric coordinates of the root in it, float32, [N, 3].
        offsets: First row of each strand in `points`, and the end of the last, int64, [N + 1].
        points: In the frame of the root (see `roots`), metres, root first, float32, [P, 3].
        widths: Diameter at root and tip, metres, float32, [N, 2].
        groups: One of `roots.GROUPS` each, uint8, [N].
        tints: What is added to the display color that settings, light and eye give, as where a photo shows streaks, at
            `TINTS` places along each strand, float32, [N, TINTS, 3]; None for nothing anywhere.
    """

    triangles: np.ndarray
    weights: np.ndarray
    offsets: np.ndarray
    points: np.ndarray
    widths: np.ndarray
    groups: np.ndarray
    tints: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(self.triangles)
        shapes = {"weights": (count, 3), "offsets": (count + 1,), "widths": (count, 2), "groups": (count,)}
        if self.tints is not None:
            shapes["tints"] = (count, TINTS, 3)
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ShapeError(f"A groom of {count} strands has {name} of size {getattr(self, name).shape}, not {shape}.")
        if self.points.ndim != 2 or self.points.shape[1] != 3 or len(self.points) > MAX_POINTS:
            raise ShapeError(
                f"Hair points of size {self.points.shape} cannot be used; give at most {MAX_POINTS} rows of x, y, z."
            )
        if self.offsets[0] != 0 or self.offsets[-1] != len(self.points) or (count and np.diff(self.offsets).min() < 2):
            raise ShapeError("Every strand needs two points or more, and every point a strand.")
        for name in ("weights", "points", "widths", *(("tints",) if self.tints is not None else ())):
            if not np.isfinite(getattr(self, name)).all():
                raise ShapeError(f"The hair's {name} have values that are not finite.")
        if len(self.points) and float(np.abs(self.points).max()) > MAX_EXTENT:
            raise ShapeError(f"A hair is longer than {MAX_EXTENT:.0f} m; give its points in metres.")

    def __len__(self) -> int:
        return len(self.triangles)

    @property
    def counts(self) -> np.ndarray:
        """Points of each strand, [N]."""
        return np.diff(self.offsets)

    @property
    def lengths(self) -> np.ndarray:
        """Of the strands, metres, [N]."""
        steps = np.linalg.norm(np.diff(self.points.astype(float), axis=0), axis=1)
        steps[self.offsets[1:-1] - 1] = 0.0  # from one strand to the next
        return np.asarray(np.add.reduceat(np.append(steps, 0.0), self.offsets[:-1]))

    @property
    def strand_of_point(self) -> np.ndarray:
        """Strand of each point, [P]."""
        return np.repeat(np.arange(len(self)), self.counts)

    @property
    def along(self) -> np.ndarray:
        """Place of each point along its strand by number, 0 at the root and 1 at the tip, [P]."""
        number = np.arange(len(self.points)) - np.repeat(self.offsets[:-1], self.counts)
        return number / np.repeat(self.counts - 1, self.counts)

    @property
    def point_tints(self) -> np.ndarray | None:
        """`tints` at each point, float32, [P, 3], or None."""
        if self.tints is None:
            return None
        at = self.along * (TINTS - 1)
        first, strand = np.minimum(at.astype(int), TINTS - 2), self.strand_of_point
        part = (at - first)[:, None].astype(np.float32)
        return self.tints[strand, first] * (1 - part) + self.tints[strand, first + 1] * part

    def tinted(self, point_tints: np.ndarray) -> Groom:
        """These strands with the tints that their points have, [P, 3]; the other way round than `point_tints`."""
        at = np.linspace(0.0, 1.0, TINTS) * (self.counts - 1)[:, None]  # [N, TINTS]
        first = np.minimum(at.astype(int), self.counts[:, None] - 2)
        part, row = (at - first)[..., None].astype(np.float32), first + self.offsets[:-1, None]
        return replace(self, tints=(point_tints[row] * (1 - part) + point_tints[row + 1] * part).astype(np.float32))

    def frames(self, template: np.ndarray, faces: np.ndarray) -> RootFrames:
        """The roots' frames on a head [V, 3] of triangles [F, 3]; made once for `posed`."""
        return RootFrames.build(template, faces, self.triangles, self.weights, self.groups)

    def posed(self, frames: RootFrames, vertices: np.ndarray) -> np.ndarray:
        """Points on a posed head [V, 3] in head space, metres, float32, [P, 3]."""
        origin, axes = frames.at(vertices)
        strand = self.strand_of_point
        local = self.points.astype(np.float32)
        turned = np.einsum("pi,pij->pj", local, axes.astype(np.float32)[strand])
        return turned + origin.astype(np.float32)[strand]

    def select(self, which: np.ndarray) -> Groom:
        """Some strands, by mask or by number."""
        numbers = np.flatnonzero(which) if np.asarray(which).dtype == bool else np.asarray(which, np.int64)
        counts = self.counts[numbers]
        offsets = np.concatenate([[0], np.cumsum(counts)])
        rows = np.arange(offsets[-1]) - np.repeat(offsets[:-1] - self.offsets[numbers], counts)
        return Groom(
            self.triangles[numbers],
            self.weights[numbers],
            offsets,
            self.points[rows],
            self.widths[numbers],
            self.groups[numbers],
            None if self.tints is None else self.tints[numbers],
        )

    def level(self, share: float) -> Groom:
        """A coarser groom: the share of the strands, the same of each group, wider by so much that they cover as much.

        A smaller share keeps a subset of what a larger one keeps, so that nothing jumps from level to level.

        Args:
            share: 0..1.
        """
        if not 0 < share <= 1:
            raise ShapeError(f"A share of {share} of the hair cannot be kept; use more than 0 and at most 1.")
        rank = (np.arange(len(self)) * 0.6180339887498949) % 1.0  # spread evenly, whatever the order of the strands
        thin = self.select(rank < share)
        return replace(thin, widths=(thin.widths * min(1.0 / share, WIDEST)).astype(np.float32))

    def resampled(self, count: int) -> Groom:
        """The same strands with `count` points each, evenly spaced along them; roots and tips stay."""
        if count < 2:
            raise ShapeError(f"{count} points a strand are too few; use 2 or more.")
        step = np.linalg.norm(np.diff(self.points, axis=0, prepend=self.points[:1]), axis=1)
        step[self.offsets[:-1]] = 0.0
        # one long axis for all strands: each takes up its own length and a gap
        travelled = np.cumsum(step + 1e-9) + self.strand_of_point
        ends = np.stack([travelled[self.offsets[:-1]], travelled[self.offsets[1:] - 1]], 1)
        at = ends[:, :1] + (ends[:, 1:] - ends[:, :1]) * np.linspace(0, 1, count)
        points = np.stack([np.interp(at.ravel(), travelled, self.points[:, k]) for k in range(3)], 1).astype(np.float32)
        return replace(self, offsets=np.arange(len(self) + 1) * count, points=points)

    def pack(self) -> dict[str, np.ndarray]:
        """Arrays for a capture's file: points as differences along the strand in steps of `QUANTUM`, no tints."""
        steps = np.round(self.points / QUANTUM).astype(np.int32)
        steps = np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.int32))
        first = np.round(self.points[self.offsets[:-1]] / QUANTUM).astype(np.int32)
        steps[self.offsets[:-1]] = 0
        small = np.abs(steps).max(initial=0) < 1 << 15
        return {
            "triangles": self.triangles.astype(np.int32), "weights": np.round(self.weights[:, :2] * 65535).astype(np.uint16),
            "counts": self.counts.astype(np.uint16), "first": first, "steps": steps.astype(np.int16 if small else np.int32),
            "widths": np.round(np.clip(self.widths * 1e6, 0, 65535)).astype(np.uint16), "groups": self.groups.astype(np.uint8),
        }  # fmt: skip

    @staticmethod
    def unpack(arrays: Mapping[str, np.ndarray]) -> Groom:
        """The opposite of `pack`, to half a `QUANTUM`. Raises `ShapeError` for arrays that do not fit together."""
        try:
            offsets = np.concatenate([[0], np.cumsum(arrays["counts"].astype(np.int64))])
            steps = arrays["steps"].astype(np.int64)
            if len(steps) != offsets[-1] or len(steps) > MAX_POINTS or len(arrays["first"]) != len(offsets) - 1:
                raise ShapeError(f"A groom has {len(steps)} points where its strands ask for {offsets[-1]}.")
            total = np.cumsum(steps, 0)
            base = arrays["first"] - total[offsets[:-1]]
            points = (total + np.repeat(base, np.diff(offsets), 0)) * QUANTUM
            two = arrays["weights"].astype(np.float32) / 65535
            weights = np.concatenate([two, 1 - two.sum(1, keepdims=True)], 1)
            widths = (arrays["widths"] * 1e-6).astype(np.float32)
            return Groom(arrays["triangles"], weights, offsets, points.astype(np.float32), widths, arrays["groups"])
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise ShapeError(f"The arrays of a groom do not fit together ({error}); make it again.") from error


def bind(
    template: np.ndarray, faces: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, weights: np.ndarray,
    points: np.ndarray, offsets: np.ndarray, widths: np.ndarray, groups: np.ndarray,
) -> Groom:  # fmt: skip
    """Bind strands in head space to the head on which they were made.

    Args:
        template: Vertices of the head model's mean, [V, 3].
        faces: Triangles of the head, [F, 3].
        vertices: The head with which the strands were made, [V, 3].
        triangles: As in `Groom`, like what follows.
        weights: Barycentric coordinates.
        points: In head space, metres, [P, 3].
        offsets: First rows.
        widths: Diameters.
        groups: Parts.
    """
    origin, axes = RootFrames.build(template, faces, triangles, weights, groups).at(vertices)
    strand = np.repeat(np.arange(len(triangles)), np.diff(offsets))
    local = np.einsum("pj,pij->pi", points - origin[strand], axes[strand])
    return Groom(
        np.asarray(triangles, np.int32), np.asarray(weights, np.float32), np.asarray(offsets, np.int64),
        local.astype(np.float32), np.asarray(widths, np.float32), np.asarray(groups, np.uint8),
    )  # fmt: skip


def join(grooms: Sequence[Groom]) -> Groom:
    """Several grooms of one head as one, in order."""
    starts = np.cumsum([0, *(len(g.points) for g in grooms)])
    offsets = np.concatenate([[0], *(g.offsets[1:] + start for g, start in zip(grooms, starts, strict=False))])
    names = ("triangles", "weights", "points", "widths", "groups")
    joined = {name: np.concatenate([getattr(g, name) for g in grooms]) for name in names}
    tints = [np.zeros((len(g), TINTS, 3), np.float32) if g.tints is None else g.tints for g in grooms]
    return Groom(offsets=offsets, **joined, tints=np.concatenate(tints) if any(g.tints is not None for g in grooms) else None)
