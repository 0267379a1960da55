"""What is captured of a person: expressions, poses and cameras of every shot, drawn from a seed. Needs numpy only.

A shot is one expression with several views. Shots of one number are alike in kind for everybody (neutral, single expressions,
mixes), so that a capture cut short still has everybody.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES, MIXTURE_NAMES
from grmm_core.data.types import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, HELD_OUT_PERSON, TRAIN
from grmm_core.errors import ConfigError
from grmm_core.geometry.camera import Camera

ORBIT_PITCHES = (-12.0, 8.0, 28.0)
MAX_CAMERAS = 24
CLOSE_SHARE = 0.45  # of the views
DISTANCE = 1.1  # metres
FULL_FOV, CLOSE_FOV, MOUTH_FOV = 23.0, 12.0, 4.4  # degrees
HELD_OUT_CAMERAS = (5, 14)  # of 24
HELD_OUT_EVERY = 12  # one person of so many is held out
HELD_OUT_SHOTS = (6, 13)  # numbers modulo 15: expressions that are not trained on
NEUTRAL, SINGLE, MIX = "neutral", "single", "mix"
MOUTH = "mouth"  # a framing of the views
# what bares teeth, one of which is in every shot of mouths
BARING = (
    ("jawOpen", 0.35, 1.0),
    ("mouthUpperUp", 0.5, 1.0),
    ("mouthLowerDown", 0.5, 1.0),
    ("mouthSmile", 0.5, 0.9),
    ("mouthFunnel", 0.5, 1.0),
)
# eyelids and mouth must be seen open and shut often: drawn more often than the rest
FREQUENT = (
    "jawOpen",
    "eyeBlinkLeft",
    "eyeBlinkRight",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthFunnel",
    "mouthPucker",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "browInnerUp",
    *MIXTURE_NAMES,
)
WIDE_SHOTS, MOUTH_ROUND = 4, 6  # of so many shots of mouths so many are wide open
SHUTTING = ("mouthStretch", "mouthClose", "mouthPucker", "mouthRoll", "mouthFrown", "mouthPress", "mouthShrug")
# combinations nobody can make
CONFLICTS = (
    ("eyeBlink", "eyeWide"),
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    ("mouthPucker", "mouthStretch"),
    ("mouthSmile", "mouthFrown"),
    ("mouthFunnel", "mouthRoll"),
    ("browDown", "browOuterUp"),
    ("eyeLookUp", "eyeLookDown"),
)


@dataclass(frozen=True)
class Shot:
    """One expression of one person.

    Attributes:
        subject, number: Which.
        kind: "neutral", "single" or "mix".
        aligned: Weights of the 60 aligned expressions, [60].
        pose: Euler angles added to those of the expression, radians, [5, 3].
        cameras: The views.
        camera_names: "c07" for the fixed ring, "f" + ring number for close-ups near it.
    """

    subject: int
    number: int
    kind: str
    aligned: np.ndarray
    pose: np.ndarray
    cameras: tuple[Camera, ...]
    camera_names: tuple[str, ...]


def held_out(index: int) -> bool:
    """Whether a person is held out from training."""
    return index % HELD_OUT_EVERY == HELD_OUT_EVERY - 1


def view_split(subject: int, number: int, camera_name: str) -> str:
    """Split of a view: held-out people, then expressions, then cameras, then training."""
    if held_out(subject):
        return HELD_OUT_PERSON
    if number % 15 in HELD_OUT_SHOTS:
        return HELD_OUT_EXPRESSION
    if camera_name in {f"c{i:02d}" for i in HELD_OUT_CAMERAS}:
        return HELD_OUT_CAMERA
    return TRAIN


def expression_pool(names: str) -> tuple[str, ...]:
    """Aligned expressions of `all` or a comma-separated list. Raises `ConfigError` for an unknown name."""
    if names == "all":
        return ALIGNED_NAMES
    pool = tuple(name.strip() for name in names.split(",") if name.strip())
    unknown = [name for name in pool if name not in ALIGNED_NAMES]
    if unknown or not pool:
        raise ConfigError(f"There is no expression named {(unknown or [''])[0]!r}; use all, or names such as jawOpen,laugh.")
    return pool


def make_shot(seed: int, subject: int, number: int, views: int, size: int, pool: tuple[str, ...] = ALIGNED_NAMES) -> Shot:
    """Draw one shot; depends on its arguments only.

    Args:
        seed: Seed of the capture.
        subject: Number of the person.
        number: Number of the shot; 0 is neutral, then mixes with every fourth a single expression at full strength.
        views: Cameras of the shot, 1 to 24.
        size: Picture side in pixels.
        pool: Expressions that may be used.
    """
    if not 1 <= views <= MAX_CAMERAS:
        raise ConfigError(f"{views} cameras a shot are not possible; use 1 to {MAX_CAMERAS}.")
    g = np.random.default_rng([seed, subject, number, 41])
    kind = NEUTRAL if number == 0 else SINGLE if number % 4 == 3 else MIX
    aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
    if kind == SINGLE:
        # the pool is walked through by everybody at a different place
        single = pool[(subject * 7 + (number // 4) * 13) % len(pool)]
        aligned[ALIGNED_NAMES.index(single)] = 1.0
        mirrored = _mirror(single)
        if mirrored in pool and g.random() < 0.5:
            aligned[ALIGNED_NAMES.index(mirrored)] = 1.0
    elif kind == MIX:
        aligned = _mix(g, pool)
    pose = np.zeros((5, 3), np.float32)
    if number > 0:
        limit = np.radians([13.0, 17.0, 9.0])
        pose[1] = np.clip(g.normal(0, 0.45, 3), -1, 1) * limit
        gaze = np.clip(g.normal(0, 0.45, 2), -1, 1) * np.radians([14.0, 24.0])
        pose[3, :2] = pose[4, :2] = gaze
        if g.random() < 0.25:
            pose[2] = np.radians([float(g.uniform(0, 8)), float(g.normal(0, 2)), 0.0])
    cameras, names = _cameras(g, views, size)
    return Shot(subject, number, kind, aligned, pose, cameras, names)


def make_mouth_shot(seed: int, subject: int, number: int, views: int, size: int) -> Shot:
    """Draw one shot of an open mouth from near, for what stands in it; depends on its arguments only.

    Arguments as for `make_shot`. In four shots of six the jaw is open in most, lips are drawn from the teeth, and other
    expressions are mixed in; in the others the mouth is hardly open, as in speech, and dark inside. Where it is
    depends on the person: cameras look at the origin, and `around` moves them.
    """
    base = make_shot(seed, subject, max(number, 1), views, size)
    g = np.random.default_rng([seed, subject, number, 43])
    if number % MOUTH_ROUND >= WIDE_SHOTS:
        aligned = base.aligned * 0.8
        aligned[ALIGNED_NAMES.index("jawOpen")] = g.uniform(0.0, 0.3)
    else:
        aligned = base.aligned * 0.5
        aligned[[_kept_from_mouths(name) for name in ALIGNED_NAMES]] = 0.0
        chosen = set(g.choice(len(BARING), int(g.integers(1, 4)), replace=False).tolist())
        if g.random() < 0.85:
            chosen.add(0)
        for name, low, high in (BARING[i] for i in sorted(chosen)):
            amount = float(g.uniform(low, high))
            for each in (name, name + "Left", name + "Right"):
                if each in ALIGNED_NAMES:
                    aligned[ALIGNED_NAMES.index(each)] = np.clip(amount * (1 + 0.1 * g.normal()), 0.05, 1.0)
    cameras, names = [], []
    for _ in range(views):
        yaw, pitch = float(np.clip(g.normal(0, 30), -60, 60)), float(np.clip(g.normal(2, 12), -20, 22))
        target = g.uniform(-0.006, 0.006, 3)
        distance = DISTANCE * float(g.uniform(0.95, 1.1))
        cameras.append(Camera.orbit(size, size, yaw, pitch, distance, MOUTH_FOV, tuple(target)))
        names.append(MOUTH)
    return Shot(subject, number, MIX, aligned, base.pose, tuple(cameras), tuple(names))


def around(camera: Camera, place: np.ndarray) -> Camera:
    """A camera that looks at the origin, moved to look at a place [3] in head space, metres."""
    back = np.eye(4)
    back[:3, 3] = -place
    return camera.transformed(back)


def ring_camera(index: int, size: int, g: np.random.Generator | None = None) -> Camera:
    """Camera of the fixed ring: 8 directions at three heights; jittered where a generator is given."""
    pitch = ORBIT_PITCHES[index % 3]
    yaw = 45.0 * (index // 3) + 15.0 * (index % 3)
    distance, fov, target = DISTANCE, FULL_FOV, np.array([0.0, -0.002, 0.0])
    if g is not None:
        yaw, pitch = yaw + float(g.uniform(-10, 10)), pitch + float(g.uniform(-7, 7))
        distance *= float(g.uniform(0.94, 1.08))
        target = target + g.uniform(-0.012, 0.012, 3)
    return Camera.orbit(size, size, yaw, pitch, distance, fov, tuple(target))


def _cameras(g: np.random.Generator, views: int, size: int) -> tuple[tuple[Camera, ...], tuple[str, ...]]:
    ring = g.permutation(MAX_CAMERAS)
    # half of the full views see the face
    cameras, names = [], []
    close = int(np.floor(views * CLOSE_SHARE + g.random()))
    for i in range(views):
        if i < close:
            yaw, pitch = float(np.clip(g.normal(0, 24), -60, 60)), float(np.clip(g.normal(4, 9), -18, 28))
            target = np.array([0.0, 0.008, 0.055]) + g.uniform(-0.014, 0.014, 3)
            cameras.append(
                Camera.orbit(size, size, yaw, pitch, DISTANCE * float(g.uniform(0.95, 1.1)), CLOSE_FOV, tuple(target))
            )
            names.append("face")
        else:
            index = int(ring[i])
            if g.random() < 0.30:  # more of the front than of the back
                index = int(g.choice([0, 1, 2, 3, 4, 21, 22, 23]))
            cameras.append(ring_camera(index, size, g))
            names.append(f"c{index:02d}")
    return tuple(cameras), tuple(names)


def _mix(g: np.random.Generator, pool: tuple[str, ...]) -> np.ndarray:
    aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
    weights = np.array([2.5 if name in FREQUENT else 1.0 for name in pool])
    count = min(len(pool), int(g.integers(2, 7)))
    chosen = g.choice(len(pool), count, replace=False, p=weights / weights.sum())
    taken: list[str] = []
    for k in chosen:
        name = pool[int(k)]
        if any(_clash(name, other) for other in taken):
            continue
        amount = float(g.beta(1.6, 1.2))
        names = [name]
        mirrored = _mirror(name)
        if mirrored in pool and g.random() < 0.7:
            names.append(mirrored)
        for each in names:
            taken.append(each)
            aligned[ALIGNED_NAMES.index(each)] = np.clip(amount * (1 + 0.1 * g.normal()), 0.05, 1.0)
    mixtures = [i for i, name in enumerate(ALIGNED_NAMES) if name in MIXTURE_NAMES and aligned[i] > 0]
    if len(mixtures) > 1:  # at most one whole-face mixture
        keep = mixtures[int(g.integers(len(mixtures)))]
        for i in mixtures:
            aligned[i] = aligned[i] if i == keep else 0.0
    total = float(aligned[: len(ARKIT_NAMES)].sum())
    return aligned * min(1.0, 5.0 / max(total, 1e-6))


def _mirror(name: str) -> str:
    if name.endswith("Left"):
        return name.removesuffix("Left") + "Right"
    if name.endswith("Right"):
        return name.removesuffix("Right") + "Left"
    return ""


def _kept_from_mouths(name: str) -> bool:
    """Whether an expression would keep the mouth shut or fight with one that bares teeth."""
    return name.startswith((*(baring for baring, _, _ in BARING), *SHUTTING)) or name in MIXTURE_NAMES


def _clash(a: str, b: str) -> bool:
    return any((a.startswith(x) and b.startswith(y)) or (a.startswith(y) and b.startswith(x)) for x, y in CONFLICTS)
