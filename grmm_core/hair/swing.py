"""Long hair that lags behind a moving head and swings: a simulation that gives the same each time. Numba or numpy.

What swings are a few places along each strand. Each is drawn to where the groom has it on the posed head by a damped spring
that is the slower the farther from the root it is, as a pendulum of that length would be; gravity counts by how it has turned
in the head's axes, so that a still upright head wears exactly its groom. Springs are integrated implicitly, so that no step is
too large; segments keep their lengths from the root on (follow the leader: Mueller, Kim and Chentanez 2012); what would enter
the head or the shoulders, as they are posed in that frame, is pushed out. After each frame strands go part of the way of those
around them, as hair drags hair along; within it each is on its own, so that threads and order change nothing. Last, lengths and
the skin are asked in turns, the skin also between places. What comes out is how far each place is from where it would follow
the head: curls, cuts and settings of the strands ride on that.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import ConfigError, FileFormatError, ShapeError
from ..files.access import atomic_write
from ..files.npz import read_npz
from ..head import HeadModel
from .body import DEEP, MOST, SLIDE, SOFT, Body, worn
from .contact import FINE, PLACES, Obstacle, held_out, rigid_motion
from .grids import nearest
from .groom import Groom
from .roots import SCALP
from .strands import evened

STEPS = 4  # of a frame
GRAVITY = 9.81  # m/s^2, along -y
STIFF = 1.3  # how much faster than a pendulum of its length hair swings back
DAMPING = 0.25  # of critical, relative to the head
SHORTEST = 0.012  # metres: nearer to the root nothing swings
JUMP = 0.08  # metres that roots may move in a frame; more is a cut, after which hair is at rest
CARRIED = 0.6  # metres, likewise, of a head that is carried
SETTLE = 1.0  # seconds that a first frame is held before what follows
SUNK = 0.003  # metres below the skin
CLEARANCE = 0.001  # metres above the skin
ROUNDS = 2  # of smoothing along a strand
FARTHEST = 0.6  # of its distance along the strand from the root, how far a place may be from where the groom has it
AROUND, TOGETHER = 12, 0.5  # strands around one, and how far it moves as these do in a frame: hair drags hair along
OUT = 4  # rounds in which what is drawn gets its lengths and is brought out of the head
RISE, HIGHEST = 0.25, 0.008  # so much of how far a place has swung it is drawn higher above the skin, metres at most
_VERSION = 1


@dataclass
class _State:
    places: np.ndarray
    speeds: np.ndarray
    targets: np.ndarray
    gravity: np.ndarray


@dataclass
class Swing:
    """The simulation of one groom on one person.

    Attributes:
        head: The head model.
        groom: What is worn; scalp hair swings.
        rest: The person at rest, metres, [V, 3].
        fps: Frames a second.
        compiled: Compute by the compiled kernel; else by its readable twin.
    """

    head: HeadModel
    groom: Groom
    rest: np.ndarray
    fps: float
    compiled: bool = True
    _state: _State | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if not 1.0 <= self.fps <= 1000.0:
            raise ConfigError(f"Hair cannot swing at {self.fps} frames a second; use 1 to 1000.")
        self._rows = np.flatnonzero(self.groom.groups == SCALP)
        rest = np.asarray(self.rest, float)
        some = worn(self.head, rest, self.groom.select(self._rows))  # what swings is what is drawn
        self._frames = some.frames(np.asarray(self.head.v_template, float), self.head.faces)
        count = int(some.counts.max(initial=2))
        self._local = evened(some.points.reshape(-1, count, 3), FINE).astype(np.float32)
        fine = self._posed(rest)
        still = fine[:, ::2]
        self._rigid = np.asarray(self.head.regions["scalp"])
        heights = Body.of(self.head, rest, near=fine.reshape(-1, 3)).heights(fine.reshape(-1, 3))[0]
        self._clear = np.minimum(heights, CLEARANCE).reshape(fine.shape[:2]).astype(np.float32)
        steps = np.linalg.norm(np.diff(still, axis=1), axis=2)
        self._lengths = steps.astype(np.float32)
        along = np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, 1)], 1)
        self._farthest = (FARTHEST * along).astype(np.float32)
        tips = still[:, 0] + 0.5 * still[:, -1]  # strands are neighbours that grow and end beside each other
        self._around = nearest(tips, tips, min(AROUND, len(tips)))[0] if len(tips) else np.zeros((0, 1), int)
        self._rates = (STIFF * np.sqrt(GRAVITY / np.maximum(along, SHORTEST))).astype(np.float32)
        sunk = self._clear[:, ::2] < -SUNK
        sunk[:, 0] = False  # roots stay anyway, and those beside an ear are below its hull
        sunk = np.logical_or.accumulate(sunk, axis=1)  # what is inside the head stays where it is
        self._loose = ((along > SHORTEST) & ~sunk).astype(np.float32)

    def frames(self, poses: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """Simulate from the first frame on.

        Args:
            poses: The posed head of each frame in the space in which gravity points along -y, metres, [V, 3].

        Yields:
            How far each strand of the groom has swung from where it would follow the head, metres, float32 [N, PLACES, 3].
        """
        self._state = None
        for vertices in poses:
            yield self.step(np.asarray(vertices, float))

    def step(self, vertices: np.ndarray, place: np.ndarray | None = None) -> np.ndarray:
        """The next frame, see `frames`.

        Args:
            vertices: The posed head, [V, 3].
            place: From the space of the vertices to one that does not move, y up, for a head that is carried or turned as a
                whole, its shoulders with it; rigid, [4, 4]. What comes out is in the space of the vertices all the same.
        """
        from .swing_kernel import swing_into

        about, by = (np.eye(3), np.zeros(3)) if place is None else (place[:3, :3], place[:3, 3])
        vertices = vertices @ about.T + by
        turn, shift = rigid_motion(vertices[self._rigid], np.asarray(self.rest, float)[self._rigid])
        fine = self._posed(vertices)
        targets = np.ascontiguousarray(fine[:, ::2])
        down = np.array([0.0, -GRAVITY, 0.0])
        gravity = (down - down @ turn).astype(np.float32)  # what is not in the groom already
        still = _State(targets.copy(), np.zeros_like(targets), targets, gravity)
        state, count = self._state, STEPS
        if state is None or np.abs(targets[:, 0] - state.targets[:, 0]).max(initial=0.0) > (JUMP if place is None else CARRIED):
            state, count = still, round(STEPS * SETTLE * self.fps)
        near = np.concatenate([fine.reshape(-1, 3), state.places.reshape(-1, 3)]) @ turn.T + shift
        obstacle = Obstacle(Body.of(self.head, vertices @ turn.T + shift, near=near), turn, shift)
        clear = np.ascontiguousarray(self._clear[:, ::2])
        dt = 1.0 / (STEPS * self.fps)
        drags = np.float32(2.0 * DAMPING) * self._rates
        springs = self._rates, drags, self._loose, self._farthest, self._lengths, gravity
        if self.compiled:
            moved = state.places, state.speeds, state.targets, targets
            swing_into(*moved, *springs, count, np.float32(dt), clear, *obstacle.numbers())
        else:
            found = swing_readable(
                state.places, state.speeds, state.targets, targets, *springs, count=count, dt=dt, clear=clear, obstacle=obstacle
            )
            state.places, state.speeds = (part.astype(np.float32) for part in found)
        apart = TOGETHER * self._loose[..., None]  # what stays with the head stays
        for part in (state.places, state.speeds):
            own = part - targets if part is state.places else part
            part += apart * (own[self._around].mean(1) - own)
        self._state = _State(state.places, state.speeds, targets, gravity)
        result = np.zeros((len(self.groom), PLACES, 3), np.float32)
        offsets = np.ascontiguousarray(_unfolded(state.places - targets), np.float32)
        # strands around this one would cut through a cheek that it touches
        far = np.minimum(RISE * np.linalg.norm(offsets, axis=2), HIGHEST)
        clear = (self._clear + evened(far[..., None], FINE)[..., 0]).astype(np.float32)
        offsets = held_out(fine, offsets, self._lengths, clear, obstacle, OUT, self.compiled)
        result[self._rows] = offsets @ about.astype(np.float32)
        return result

    def _posed(self, vertices: np.ndarray) -> np.ndarray:
        """Points of the strands that follow a head [V, 3], float32 [M, FINE, 3]."""
        origin, axes = (part.astype(np.float32) for part in self._frames.at(vertices))
        return np.ascontiguousarray(np.matmul(self._local, axes) + origin[:, None])


def _unfolded(offsets: np.ndarray) -> np.ndarray:
    """Offsets [M, S, 3] of strands that bend less where contact has folded them; roots stay."""
    for _ in range(ROUNDS):
        tip = 0.5 * (offsets[:, -1:] + 2.0 * offsets[:, -2:-1] - offsets[:, -3:-2])
        middle = 0.5 * offsets[:, 1:-1] + 0.25 * (offsets[:, :-2] + offsets[:, 2:])
        offsets = np.concatenate([offsets[:, :1], middle, tip], 1)
    return offsets


def swing_readable(
    places: np.ndarray, speeds: np.ndarray, before: np.ndarray, targets: np.ndarray, rates: np.ndarray, drags: np.ndarray,
    loose: np.ndarray, farthest: np.ndarray, lengths: np.ndarray, gravity: np.ndarray, count: int, dt: float,
    clear: np.ndarray, obstacle: Obstacle,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """The readable twin of `swing_kernel.swing_into`, which says what the arguments are; returns places and speeds."""
    places, speeds = places.astype(float), speeds.astype(float)
    drag = drags[..., None]
    own = (targets - before) / (count * dt)
    for step in range(count):
        goals = before + (step + 1) / count * (targets - before)
        force = rates[..., None] ** 2 * (goals - places) + drag * own + gravity
        moved = (speeds + dt * force) / (1.0 + dt * (drag + dt * rates[..., None] ** 2))
        slide = np.ones(places.shape[:2])
        lag = loose[..., None] * (places + dt * moved - goals)
        new = goals + lag * np.minimum(1.0, farthest / np.maximum(np.linalg.norm(lag, axis=2), 1e-9))[..., None]
        for s in range(1, places.shape[1]):
            free = loose[:, s] > 0
            touched = np.zeros(len(new), bool)
            for _ in range(2):
                along = new[:, s] - new[:, s - 1]
                along *= (lengths[:, s - 1] / np.maximum(np.linalg.norm(along, axis=1), 1e-9))[:, None]
                held = new[:, s - 1] + along
                out = _outside(held, loose[:, s], clear[:, s], obstacle)
                touched |= (out != held).any(1)
                held = out
                new[:, s] = np.where(free[:, None], held, new[:, s])
            slide[touched, s] = SLIDE
        places, speeds = new, slide[..., None] * (new - places) / dt
    return places, speeds


def _outside(points: np.ndarray, loose: np.ndarray, clear: np.ndarray, obstacle: Obstacle) -> np.ndarray:
    """Points [N, 3] where they are loose [N] brought some of the way up to their heights [N] above a body."""
    under, up = obstacle.under(points, clear)
    push = np.maximum(np.clip(SOFT * under, 0.0, MOST), under - DEEP)
    return np.asarray(points + np.where(loose > 0, push, 0.0)[:, None] * up)


def write_bake(path: str | Path, frames: Iterable[np.ndarray], start: int, fps: float) -> int:
    """Keep what `Swing.frames` yields in a file, in steps of 0.1 mm; returns how many frames. Raises `FileAccessError`."""
    rows = [np.round(np.clip(frame, -3.2, 3.2) / 1e-4).astype(np.int16) for frame in frames]
    with atomic_write(Path(path)) as file:
        np.savez_compressed(
            file, version=np.array([_VERSION]), frames=np.stack(rows), start=np.array([start]), fps=np.array([fps])
        )
    return len(rows)


@dataclass(frozen=True)
class SwingBake:
    """Swinging that was kept.

    Attributes:
        frames: Of `Swing.frames`, in steps of 0.1 mm, int16 [T, N, S, 3].
        start: Number of the first frame.
        fps: Frames a second.
    """

    frames: np.ndarray
    start: int
    fps: float

    @staticmethod
    def read(path: str | Path) -> SwingBake:
        """Read a file. Raises `FileAccessError`, `FileFormatError`."""
        arrays = read_npz(Path(path))[0]
        try:
            frames, version = arrays["frames"], int(arrays["version"][0])
            start, fps = int(arrays["start"][0]), float(arrays["fps"][0])
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise FileFormatError(f"{path} holds no baked hair; bake it again.") from error
        if version != _VERSION or frames.dtype != np.int16 or frames.ndim != 4 or frames.shape[2:] != (PLACES, 3):
            raise FileFormatError(f"{path} holds baked hair of another kind than this version's; bake it again.")
        return SwingBake(frames, start, fps)

    @functools.cached_property
    def digest(self) -> str:
        """What tells one movement from another: a file may have been written anew since somebody read it."""
        found = hashlib.blake2b(np.ascontiguousarray(self.frames).data, digest_size=16)
        found.update(repr((self.frames.shape, self.start, self.fps)).encode())
        return found.hexdigest()

    def at(self, frame: int, strands: int) -> np.ndarray:
        """What `HairUse.swing` takes of a frame; the ends are held. Raises `ShapeError` for a groom of other strands."""
        if self.frames.shape[1] != strands:
            raise ShapeError(f"The baked hair has {self.frames.shape[1]} strands, the groom {strands}; bake it again.")
        row = self.frames[int(np.clip(frame - self.start, 0, len(self.frames) - 1))]
        return (row * np.float32(1e-4)).astype(np.float32)
