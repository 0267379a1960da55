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
LEAVES = 0.06  # metres by which hair that falls away from the head leaves it higher up
HELD = 0.35  # how much less hair hangs that falls towards the head: cheek and neck hold it
FALLS = 0.5  # of `_away`, to either side: from there on hair falls freely, or is held
TAKEN_BACK = 0.5  # of what hair hangs that may as well lie on neck and shoulder
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
        middles: Of the segments between these, at rest, float32 [M, PLACES - 1, 3] metres.
    """

    head: HeadModel
    rest: np.ndarray
    below: float
    rows: np.ndarray
    clear: np.ndarray
    lengths: np.ndarray
    middles: np.ndarray

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
        return (Shoulders(head, rest, below, rows, clear.astype(np.float32), steps, fine[:, 1::2].astype(np.float32)),)

    @property
    def nbytes(self) -> int:
        """What it takes, bytes, as caches ask."""
        return sum(array.nbytes for array in (self.rest, self.rows, self.clear, self.lengths, self.middles))

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
        free = _free(self.head, self.rest, self.middles[:count], turn @ down)
        hung = _hanging(fine[:, ::2], -turn[1], down, begun * free)
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


def unhung(head: HeadModel, rest: np.ndarray, strands: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Strands at rest that, on a head tilted until `down` [3] is down, hang where strands [N, K, 3] are that go along with it.

    What falls away from the head hangs freely. Hair on its other side may as well lie on neck and shoulder: it is taken back
    by half. What is behind the head nobody has seen; it stays as it is.

    Args:
        head: The head model.
        rest: The person at rest, metres, [V, 3].
        strands: In the head's axes.
        down: Likewise.
    """
    below = float(rest[np.asarray(head.weights)[:, 0] > ROOT_SHARE, 1].max())
    found = np.asarray(strands, np.float32)
    reaching = (found[..., 1].min(1) < below) & (lengths_of(found) > LONG)
    tilted, back = np.asarray(down, np.float32) / np.linalg.norm(down), np.array([0.0, -1.0, 0.0], np.float32)
    for _ in range(ROUNDS):  # how far a segment hangs is told by where it is at rest
        middles = 0.5 * (found[:, 1:] + found[:, :-1])
        beside = (_away(head, rest, middles, tilted) / FALLS).clip(-1.0, 1.0)
        free = _free(head, rest, middles, tilted) * np.maximum(beside, -TAKEN_BACK * beside) * reaching[:, None]
        found = np.asarray(strands + _hanging(np.asarray(strands, np.float32), tilted, back, free), np.float32)
    return found


def _free(head: HeadModel, rest: np.ndarray, middles: np.ndarray, down: np.ndarray) -> np.ndarray:
    """How much of the head's tilt segments with middles [N, S, 3] at rest do not follow, float32 [N, S].

    `down` [3] is where the bust's down goes in the head's axes.
    """
    away = _away(head, rest, middles, down)
    begins = HANGS[0] + LEAVES * away.clip(0.0)
    share = ((begins - (middles[..., 1] - _ears(head, rest)[1])) / (begins - HANGS[1])).clip(0.0, 1.0)
    held = 1.0 - HELD * (-away / FALLS).clip(0.0, 1.0)
    free: np.ndarray = (share**2 * (3.0 - 2.0 * share) * held).astype(np.float32)
    return free


def _away(head: HeadModel, rest: np.ndarray, middles: np.ndarray, down: np.ndarray) -> np.ndarray:
    """How much segments are on the side to which the head is tilted, where hair falls away from it, -1..1; as `_free`."""
    beside = (middles - _ears(head, rest))[..., ::2]
    way = np.asarray(down)[::2] / max(float(np.linalg.norm(down[::2])), 1e-6)
    away: np.ndarray = beside @ way / np.maximum(np.linalg.norm(beside, axis=-1), 1e-6)
    return away


def _ears(head: HeadModel, rest: np.ndarray) -> np.ndarray:
    """The middle between the ears, of a head without the middle of its scalp, [3]."""
    middle: np.ndarray = rest[np.asarray(head.regions.get("ears", head.regions["scalp"]))].mean(0)
    return middle


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
