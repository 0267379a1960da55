"""Long hair of a head that turns or bows, where it comes to rest when it does not swing. Needs numba.

Strands follow the scalp, and below the ears they hang down as far as the head has tilted. Shoulders do not turn with it: what
would get into them and the neck is brought out, with its length, onto the skin as it is posed. All of that is a function of the
pose alone, so that every frame is the same whichever was drawn before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..head import HeadModel
from .body import CLEARANCE, LYING, Body
from .contact import FINE, Obstacle, held_out, moved, rigid_motion
from .strands import evened, lengths_of

LONG = 0.06  # metres: shorter strands reach no shoulder
ROOT_SHARE = 0.3  # of a vertex's skinning weights that the root joint has from where on it is a shoulder's or the neck's
FIXED_SHARE = 0.6  # and from where on it neither turns with the head nor moves with the jaw
STILL = 0.002  # metres that the fixed ones may move in the head's axes before it counts, as they do with a raised brow
GIVES = 0.006  # metres that strands may sink in where it begins to count, so that nothing jumps
HANGS = (0.005, -0.095)  # metres above the ears at rest: below that the head no longer holds hair, and where it hangs freely
ROUNDS = 4
TOUCHED, SHALLOW = 1e-5, 1e-3  # metres: moves beyond rounding, and up to where one round is enough


@dataclass(frozen=True)
class Shoulders:
    """What strands of one person's hair reach the shoulders, and how high above these they lie.

    Attributes:
        head: The head model.
        rest: The person at rest, metres, [V, 3].
        below: Height below which shoulders are, at rest, metres.
        rows: Which strands reach there, [M].
        clear: Height above the skin that their points keep, float32 [M, FINE] metres.
        lengths: Between their places, float32 [M, PLACES - 1] metres.
        free: How much of the head's tilt the segments between places do not follow, 0..1 float32 [M, PLACES - 1].
    """

    head: HeadModel
    rest: np.ndarray
    below: float
    rows: np.ndarray
    clear: np.ndarray
    lengths: np.ndarray
    free: np.ndarray

    @staticmethod
    def of(head: HeadModel, rest: np.ndarray, strands: np.ndarray, lock: np.ndarray) -> tuple[Shoulders, ...]:
        """Prepare strands [N, K, 3] of a person at rest [V, 3]; nothing where no strand gets there.

        `lock` is how high each lock lies among others, -1..1 [N].
        """
        own = np.asarray(head.weights)[:, 0] > ROOT_SHARE
        if not own.any() or strands.shape[1] < 2:
            return ()
        below = float(rest[own, 1].max())
        lengths = lengths_of(strands)
        rows = np.flatnonzero((strands[..., 1].min(1) < below) & (lengths > LONG))
        if not len(rows):
            return ()
        fine = evened(strands[rows], FINE)
        heights = Body.of(head, rest, near=fine.reshape(-1, 3), below=below).heights(fine.reshape(-1, 3))[0]
        lying = (LYING * lengths[rows] * (1.0 + 0.5 * lock[rows]))[:, None] * np.linspace(0, 1, FINE) ** 2
        steps = np.linalg.norm(np.diff(fine[:, ::2], axis=1), axis=2).astype(np.float32)
        clear = np.minimum(heights.reshape(fine.shape[:2]), CLEARANCE + lying)
        ears = rest[np.asarray(head.regions.get("ears", ()), int), 1]
        heights = fine[:, 1::2, 1] - (ears.mean() if len(ears) else below)
        share = ((HANGS[0] - heights) / (HANGS[0] - HANGS[1])).clip(0.0, 1.0)
        free = (share**2 * (3.0 - 2.0 * share)).astype(np.float32)
        return (Shoulders(head, rest, below, rows, clear.astype(np.float32), steps, free),)

    @property
    def nbytes(self) -> int:
        """What it takes, bytes, as caches ask."""
        return sum(array.nbytes for array in (self.rest, self.rows, self.clear, self.lengths, self.free))

    def left(self, vertices: np.ndarray, strands: np.ndarray, compiled: bool = True) -> np.ndarray:
        """Strands [N, K, 3] that follow a posed head [V, 3], the first of those that were prepared, hanging beside its neck.

        `compiled` as of `contact.held_out`.
        """
        count = int(np.searchsorted(self.rows, len(strands)))
        rigid, own = np.asarray(self.head.regions["scalp"]), np.asarray(self.head.weights)[:, 0] > FIXED_SHARE
        turn, shift = rigid_motion(vertices[rigid], self.rest[rigid])
        upright = vertices @ turn.T + shift
        far = float(np.linalg.norm(upright[own] - self.rest[own], axis=1).max())
        if far < STILL or not count:
            return strands
        begun = min((far - STILL) / GIVES, 1.0)
        rows = self.rows[:count]
        fine = evened(strands[rows], FINE).astype(np.float32)
        down = -rigid_motion(vertices[own], self.rest[own])[0][1]  # the bust's, which may lie
        hung = _hanging(fine[:, ::2], -turn[1], down, begun * self.free[:count])
        near = np.concatenate([fine, fine[:, ::2] + hung], 1).reshape(-1, 3) @ turn.T + shift
        body = Body.of(self.head, upright, near=near, below=self.below)
        obstacle, clear = Obstacle(body, turn, shift), self.clear[:count] - np.float32(GIVES * (1.0 - begun))
        offsets = held_out(fine, hung, self.lengths[:count], clear, obstacle, 1, compiled)
        deep = np.flatnonzero(np.abs(offsets - hung).max((1, 2)) > SHALLOW)
        some = np.flatnonzero(np.abs(offsets).max((1, 2)) > TOUCHED)
        offsets[deep] = held_out(fine[deep], offsets[deep], self.lengths[deep], clear[deep], obstacle, ROUNDS, compiled)
        result = strands.copy()
        result[rows[some]] = moved(strands[rows[some]], offsets[some])
        return result


def _hanging(places: np.ndarray, leaning: np.ndarray, down: np.ndarray, free: np.ndarray) -> np.ndarray:
    """How far places [M, S, 3] of strands on a tilted head hang from where they follow it, float32 [M, S, 3] metres.

    Each segment is turned by a share `free` [M, S - 1] of the way from the head's own `leaning` to `down`, unit vectors.
    """
    axis = np.cross(leaning, down)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-6:
        return np.zeros_like(places)
    x, y, z = axis / sine
    turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]], np.float32)  # `step @ turned` is the axis x the step
    angles = np.float32(np.arctan2(sine, leaning @ down)) * free[..., None]
    steps = np.diff(places, axis=1) @ turned
    offsets = np.zeros_like(places)
    np.cumsum(np.sin(angles) * steps + (1.0 - np.cos(angles)) * (steps @ turned), axis=1, out=offsets[:, 1:])
    return offsets
