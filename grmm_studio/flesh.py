"""What soft tissue does that linear shapes cannot: added to the posed vertices before rendering. Needs numpy and scipy.

Sums of shapes saturate, cheeks bulge against the fold of a smile, skin slides over bone, lips stick and roll, lids follow the
eye and bulge over the cornea, broad wrinkles fold. How much differs from person to person; the same person does the same in
every shot. `Flesh.displacement` is a pure function of the shot, so a displacement need not be stored to be had again.
All places are template positions (head space, metres); what is a person's own is drawn from `Subject.asymmetry`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.hair.lashes import rigid
from grmm_core.head import HeadModel
from grmm_core.wrinkles.noise import bump, smoothstep

from .mesh import region_vertices
from .subjects import Subject

Place = tuple[float, float, float]
SIDES = (("Left", 1.0), ("Right", -1.0))
LIMIT = 1.25  # of the longest shape at a vertex: where a sum of shapes ends
STICKY = 0.0075  # metres of gap that the stickiest lips bridge in the corners
LID_SHARE = {"upper": 0.55, "lower": 0.22}  # of the eye's pitch that lids follow beyond what their shapes do
CORNEA = 0.0008  # metres that it stands out
CORNEA_ANGLE = 0.38  # radians


@dataclass(frozen=True)
class Bulge:
    """One place that moves where shapes act together.

    Attributes:
        drivers: Alternatives of shapes without their side, joined by "*" where all must act; the strongest counts.
        place, radii: On the left side; on the right mirrored.
        out: Metres along the skin's normal.
        move: Metres across it in head space, x away from the middle.
        spared: Shape that takes it back.
        aged: How much more at 80 than at 20, as a share.
    """

    drivers: tuple[str, ...]
    place: Place
    radii: Place
    out: float = 0.0
    move: Place = (0.0, 0.0, 0.0)
    spared: str = ""
    aged: float = 0.0


BULGES: dict[str, Bulge] = {
    "apple": Bulge(
        ("mouthSmile", "cheekSquint", "noseSneer"), (0.040, 0.002, 0.088), (0.017, 0.012, 0.03), 0.0034, (0, 0.0008, 0),
        "jawOpen",
    ),
    "fold": Bulge(
        ("mouthSmile", "noseSneer", "mouthUpperUp"), (0.030, -0.014, 0.096), (0.0055, 0.014, 0.02), -0.0018, aged=0.9,
    ),
    "corner": Bulge(("mouthSmile", "mouthDimple"), (0.031, -0.030, 0.092), (0.007, 0.008, 0.02), -0.0016),
    "dimple": Bulge(("mouthSmile",), (0.040, -0.028, 0.083), (0.0055, 0.007, 0.02), -0.0016),
    "jowl": Bulge(("mouthFrown", "mouthStretch"), (0.036, -0.054, 0.083), (0.013, 0.012, 0.03), 0.0020, aged=1.0),
    "open_smile": Bulge(("jawOpen*mouthSmile",), (0.036, -0.030, 0.088), (0.011, 0.016, 0.03), -0.0030, (-0.0016, 0.0, -0.001)),
    "open_cheek": Bulge(("jawOpen",), (0.050, -0.024, 0.066), (0.016, 0.022, 0.03), -0.0024),
    "open_pucker": Bulge(
        ("jawOpen*mouthPucker", "jawOpen*mouthFunnel"), (0.016, -0.032, 0.108), (0.012, 0.014, 0.02), 0.0, (0, 0, 0.0022)
    ),
    "press": Bulge(
        ("mouthPress", "mouthRollLower", "mouthRollUpper"), (0.014, -0.041, 0.106), (0.014, 0.005, 0.02), 0.0, (0, 0, 0.0016)
    ),
    "press_upper": Bulge(("mouthPress", "mouthRollUpper"), (0.012, -0.022, 0.110), (0.013, 0.0035, 0.02), 0.0, (0, 0, 0.0012)),
    "roll_lower": Bulge(("mouthRollLower",), (0.008, -0.037, 0.108), (0.015, 0.0035, 0.02), 0.0, (0, 0.0008, -0.0020)),
    "roll_upper": Bulge(("mouthRollUpper",), (0.008, -0.0275, 0.110), (0.015, 0.0035, 0.02), 0.0, (0, -0.0006, -0.0018)),
    "pout": Bulge(("mouthPucker", "mouthFunnel"), (0.006, -0.0315, 0.112), (0.012, 0.009, 0.02), 0.0, (0, 0, 0.0020)),
    "chin": Bulge(
        ("mouthShrugLower", "mouthFrown*mouthPress"), (0.006, -0.058, 0.104), (0.012, 0.009, 0.03), 0.0020, (0, 0.001, 0)
    ),
    "frown": Bulge(("browDown",), (0.013, 0.058, 0.106), (0.006, 0.007, 0.02), 0.0022, aged=0.4),
    "frown_line": Bulge(("browDown",), (0.005, 0.060, 0.108), (0.0035, 0.010, 0.02), -0.0016, aged=0.8),
    "grief": Bulge(("browDown*browInnerUp", "browInnerUp"), (0.012, 0.070, 0.106), (0.012, 0.007, 0.03), 0.0016, aged=0.3),
    "brow_ridge": Bulge(("browOuterUp",), (0.043, 0.060, 0.092), (0.012, 0.006, 0.02), 0.0011),
    "squint": Bulge(("eyeSquint", "cheekSquint"), (0.030, 0.0235, 0.094), (0.014, 0.0045, 0.02), 0.0018),
    "squeeze": Bulge(("eyeBlink*cheekSquint", "eyeBlink*eyeSquint"), (0.047, 0.034, 0.083), (0.008, 0.009, 0.02), 0.0016),
    "bunny": Bulge(("noseSneer",), (0.011, 0.028, 0.108), (0.005, 0.009, 0.02), 0.0016, (0, 0.0008, 0), aged=0.3),
    "wing": Bulge(
        ("noseSneer*mouthSmile", "noseSneer"), (0.017, -0.004, 0.106), (0.006, 0.006, 0.02), 0.0009, (0.0012, 0.001, 0)
    ),
    "platysma": Bulge(("mouthStretch", "jawForward"), (0.022, -0.098, 0.040), (0.006, 0.030, 0.06), 0.0026, aged=0.7),
    "puff": Bulge(("cheekPuff*mouthSmile", "cheekPuff*jawOpen"), (0.042, -0.022, 0.082), (0.018, 0.016, 0.03), -0.004),
}  # fmt: skip

# skin that slides on bone without lifting off: drivers, place, radii, metres in head space (x away from the middle)
SLIDES: tuple[tuple[tuple[str, ...], Place, Place, Place], ...] = (
    (("browInnerUp", "browOuterUp"), (0.020, 0.100, 0.085), (0.050, 0.035, 0.07), (0.0, 0.0055, 0.0)),
    (("browOuterUp",), (0.066, 0.060, 0.045), (0.020, 0.030, 0.04), (0.0, 0.0030, -0.0010)),
    (("browDown",), (0.012, 0.090, 0.098), (0.035, 0.024, 0.05), (-0.0006, -0.0032, 0.0)),
    (("mouthSmile",), (0.070, 0.008, 0.020), (0.014, 0.030, 0.04), (0.0, 0.0015, -0.0028)),
    (("jawOpen",), (0.052, -0.006, 0.066), (0.018, 0.022, 0.03), (0.0, -0.0030, 0.0)),
    (("mouthStretch", "mouthFrown"), (0.040, -0.080, 0.055), (0.030, 0.030, 0.05), (0.0008, 0.0030, 0.0)),
    (("mouthLeft", "mouthRight"), (0.045, -0.015, 0.085), (0.022, 0.022, 0.03), (0.0, 0.0, -0.0020)),
)
# broad folds across the forehead: drivers, height of the middle, metres between folds, metres of height
FOLDS = (("browInnerUp", 0.0), ("browOuterUp", 0.034))  # and where on x they are strongest
FOLD_GAP, FOLD_HEIGHT = 0.0150, 0.0013


class Flesh:
    """The soft tissue of one person."""

    def __init__(self, subject: Subject, head: HeadModel, neutral: np.ndarray) -> None:
        """Lay everything out for a person with neutral vertices [V, 3]."""
        g = np.random.default_rng([subject.asymmetry, 71])
        template = np.asarray(head.v_template, float)
        age = float(np.clip((subject.macros["age"] - 20) / 60, 0, 1))
        full = 0.7 + 0.6 * subject.macros["weight"]  # of soft tissue
        self.head, self._neutral = head, neutral
        self._dirs = np.asarray(head.expression_dirs, float)[..., : len(ARKIT_NAMES)]
        skin = np.ones(len(template))
        for name in ("left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "mouth_interior"):
            skin[region_vertices(head, name)] = 0.0
        # the lining goes along where it meets the lips, lashes go with their lids
        lining, lips = region_vertices(head, "mouth_interior"), region_vertices(head, "lips")
        away = cKDTree(template[np.setdiff1d(lips, lining)]).query(template[lining])[0]
        skin[lining] = np.exp(-((away / 0.006) ** 2))
        self._skin, self._lashes = skin, region_vertices(head, "lashes")
        lids = np.setdiff1d(region_vertices(head, "lids"), self._lashes)
        self._lids = lids[cKDTree(template[lids]).query(template[self._lashes])[1]]
        longest = np.linalg.norm(self._dirs, axis=1).max(1)
        self._longest, self._room = longest, (LIMIT * float(g.uniform(0.9, 1.2)) - 1) * longest + 1e-5
        self._steady = template[:, 1] > 0.02  # moves with the skull
        # drivers, where, metres out, metres across, what spares it
        self._bulges: list[tuple[tuple[str, ...], str, np.ndarray, float, np.ndarray, str]] = []
        for row in BULGES.values():
            own = np.clip(np.exp(g.normal(0, 0.45)), 0.3, 2.0) * (1 + row.aged * age) * (full if row.out > 0 else 1.0)
            shift = g.normal(0, 0.0015, 3)
            for side, sign in SIDES:
                amount = own * np.exp(g.normal(0, 0.15))
                where = self._at(template, np.asarray(row.place) + shift, row.radii, sign) * skin
                move = np.array(row.move) * (sign, 1, 1) * amount
                self._bulges.append((row.drivers, side, where, row.out * amount, move, row.spared))
        for drivers, place, radii, move in SLIDES:
            own = np.clip(np.exp(g.normal(0, 0.35)), 0.4, 1.8)
            for side, sign in SIDES:
                where = self._at(template, np.asarray(place), radii, sign) * skin
                self._bulges.append((drivers, side, where, 0.0, np.array(move) * (sign, 1, 1) * own, ""))
        self._slides = 2 * len(SLIDES)  # the last of the bulges
        self._folds = self._forehead(template, g, (0.35 + 1.0 * age) * np.exp(g.normal(0, 0.4)))
        self._stick = float(STICKY * g.uniform(0.15, 1.0))
        self._lips = _lip_pairs(head, template)
        self._eyes = [_Eye(head, template, name, float(g.uniform(0.8, 1.2))) for name in ("left", "right")]

    def displacement(self, posed: np.ndarray, normals: np.ndarray, expression: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """What is added to the posed vertices, head space, metres, [V, 3].

        Args:
            posed: Vertices of the mesh model, [V, 3].
            normals: Their unit normals, [V, 3].
            expression: Head-model coefficients, [E].
            pose: Euler angles of the five joints, radians, [5, 3].
        """
        values = dict(zip(ARKIT_NAMES, (float(v) for v in np.clip(expression[: len(ARKIT_NAMES)], 0, 1.2)), strict=True))
        turn = rigid(self._neutral[self._steady], posed[self._steady])
        total = self._saturation(np.array(list(values.values()))) @ turn
        slid = np.zeros_like(total)
        first_slide = len(self._bulges) - self._slides
        for i, (drivers, side, where, out, move, spared) in enumerate(self._bulges):
            amount = max(_product(values, driver, side) for driver in drivers)
            if amount < 1e-3:
                continue
            amount = amount**1.5 * (1 - 0.6 * _of(values, spared, side) if spared else 1.0)
            if i < first_slide:
                total += (amount * where)[:, None] * (out * normals + move @ turn)
            else:
                slid += (amount * where)[:, None] * (move @ turn)
        slid -= (slid * normals).sum(1, keepdims=True) * normals
        total += slid
        for name, side, relief in self._folds:
            total += (_of(values, name, side) ** 1.3 * relief)[:, None] * normals
        total += self._sticky(posed + total)
        for eye, index in zip(self._eyes, (3, 4), strict=True):
            shaped = np.einsum("e,ek->k", expression, np.asarray(self.head.expression_pose, float)[: len(expression), index])
            total += eye.displacement(posed + total, turn, pose[index], float(pose[index, 0] - shaped[0]), values)
        total *= self._skin[:, None]
        total[self._lashes] = total[self._lids]
        return total.astype(np.float32)

    def _at(self, template: np.ndarray, place: np.ndarray, radii: Place, sign: float) -> np.ndarray:
        x, y, z = (float(v) for v in place)
        own, other = (bump(template * (way, 1, 1), (x, y, z), radii, mirror=False) for way in (sign, -sign))
        return own / np.maximum(own + other, 1.0)  # in the middle both sides act as one

    def _saturation(self, weights: np.ndarray) -> np.ndarray:
        """What a sum of shapes is too long, [V, 3] on the neutral head."""
        moved = self._dirs @ weights
        length = np.linalg.norm(moved, axis=1)
        over = np.maximum(length - self._longest, 0.0)
        shorter = np.minimum(length, self._longest) + self._room * np.tanh(over / self._room)
        return moved * (shorter / np.maximum(length, 1e-9) - 1)[:, None]

    def _forehead(self, template: np.ndarray, g: np.random.Generator, height: float) -> list[tuple[str, str, np.ndarray]]:
        x, y = template[:, 0], template[:, 1]
        gap, bow = FOLD_GAP * float(g.uniform(0.85, 1.2)), float(g.uniform(-4.0, 6.0))
        wave = np.cos(2 * np.pi * (y + bow * x**2) / gap + float(g.uniform(0, 6.3)))
        wave = np.sign(wave) * np.abs(wave) ** 0.8
        area = smoothstep(0.060, 0.070, y) * smoothstep(0.118, 0.10, y) * (template[:, 2] > 0.03) * self._skin
        folds = []
        for name, at in FOLDS:
            for side, sign in SIDES if at else (("", 1.0),):
                where = np.exp(-(((sign * x - at) / 0.026) ** 2))
                folds.append((name, side, FOLD_HEIGHT * height * wave * where * area))
        return folds

    def _sticky(self, posed: np.ndarray) -> np.ndarray:
        """Lips that part hold on to each other, longest in the corners."""
        upper, lower, outward, near, share = self._lips
        gap = posed[upper] - posed[lower]
        length = np.linalg.norm(gap, axis=1)
        opened = np.maximum(length - np.linalg.norm(self._neutral[upper] - self._neutral[lower], axis=1), 0.0)
        hold = smoothstep(1.0, 0.35, opened / (self._stick * (0.12 + 0.88 * outward**3)))
        pull = 0.5 * (hold * opened / np.maximum(length, 1e-9))[:, None] * gap
        moves = np.concatenate([-pull, pull])
        total = np.zeros_like(posed)
        total[near] = share @ moves
        return total


class _Eye:
    """Lids of one eye."""

    def __init__(self, head: HeadModel, template: np.ndarray, name: str, share: float) -> None:
        ball = region_vertices(head, f"{name}_eyeball")
        self.centre_of = ball
        centre = 0.5 * (template[ball].min(0) + template[ball].max(0))
        sign = 1.0 if name == "left" else -1.0
        self.side = "Left" if name == "left" else "Right"
        local = template - centre
        around = np.exp(-((local[:, 0] / 0.017) ** 2)) * (local[:, 2] > 0) * (np.abs(template[:, 0] - centre[0]) < 0.022)
        radius = np.linalg.norm(local, axis=1)
        close = smoothstep(0.024, 0.0175, radius)  # lids lie on the ball; the brow does not
        skin = np.ones(len(template))
        skin[ball] = 0
        self.upper = share * LID_SHARE["upper"] * around * close * smoothstep(-0.001, 0.002, local[:, 1]) * skin
        self.lower = share * LID_SHARE["lower"] * around * close * smoothstep(0.000, -0.003, local[:, 1]) * skin
        self.thin = close * skin * (sign * template[:, 0] > 0)

    def displacement(
        self, posed: np.ndarray, turn: np.ndarray, gaze: np.ndarray, pitch: float, values: dict[str, float]
    ) -> np.ndarray:
        """Follow `pitch` radians (down positive) that shapes do not show, and bulge over the cornea, [V, 3]."""
        centre = 0.5 * (posed[self.centre_of].min(0) + posed[self.centre_of].max(0))
        local = (posed - centre) @ turn.T  # upright
        shut = _of(values, "eyeBlink", self.side)
        angle = pitch * (self.upper * (1 - 0.8 * min(shut, 1.0)) * (1.0 if pitch > 0 else 0.7) + self.lower)
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = local.T
        turned = np.stack([x, c * y - s * z, s * y + c * z], 1)
        pupil = np.array([np.sin(gaze[1]) * np.cos(gaze[0]), -np.sin(gaze[0]), np.cos(gaze[1]) * np.cos(gaze[0])])
        direction = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-6)
        ahead = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-6)
        # the mesh model's lids already lie over a cornea that looks ahead
        out = CORNEA * (_cornea(direction @ pupil) - _cornea(ahead[:, 2])) * self.thin
        return (turned + out[:, None] * direction - local) @ turn


def _cornea(cosine: np.ndarray) -> np.ndarray:
    return np.exp(-((np.arccos(np.clip(cosine, -1, 1)) / CORNEA_ANGLE) ** 2))


def _lip_pairs(head: HeadModel, template: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of both lips that touch when the mouth is shut.

    Returns:
        Upper and lower vertices, [P] each; how far outward each pair is, 0..1; vertices that go along, [N], and their shares of
        the moves of upper, then lower vertices, [N, 2 P].
    """
    lips = region_vertices(head, "lips")
    faces = np.asarray(head.faces)
    # upper or lower by which shapes move it
    opened = np.asarray(head.expression_dirs)[..., ARKIT_NAMES.index("mouthLowerDownLeft")]
    opened = opened + np.asarray(head.expression_dirs)[..., ARKIT_NAMES.index("mouthLowerDownRight")]
    lifted = np.asarray(head.expression_dirs)[..., ARKIT_NAMES.index("mouthUpperUpLeft")]
    lifted = lifted + np.asarray(head.expression_dirs)[..., ARKIT_NAMES.index("mouthUpperUpRight")]
    low = -opened[lips, 1] > lifted[lips, 1]
    above, below = lips[~low], lips[low]
    distance = np.linalg.norm(template[above][:, None] - template[below][None], axis=2)
    chosen = np.flatnonzero(distance.min(1) < 0.0022)
    upper, lower = above[chosen], below[distance.argmin(1)[chosen]]
    outward = np.clip(np.abs(template[upper, 0]) / np.abs(template[lips, 0]).max(), 0, 1)
    around = np.unique(faces[np.isin(faces, lips).any(1)])
    ends = np.concatenate([upper, lower])
    # vertices of a lip follow their own lip
    lower_side = np.zeros(len(template), bool)
    lower_side[below] = True
    other = ~np.isin(around, lips)
    lower_side[around[other]] = template[around[other], 1] < template[lips, 1].mean()
    same = lower_side[around][:, None] == np.concatenate([np.zeros(len(upper), bool), np.ones(len(lower), bool)])[None]
    kernel = np.exp(-((np.linalg.norm(template[around][:, None] - template[ends][None], axis=2) / 0.0028) ** 2)) * same
    # far from the seam less than a whole move
    return upper, lower, outward, around, kernel / np.maximum(kernel.sum(1, keepdims=True), 0.8)


def _of(values: dict[str, float], name: str, side: str) -> float:
    return values.get(name + side, values.get(name, 0.0))


def _product(values: dict[str, float], driver: str, side: str) -> float:
    result = 1.0
    for name in driver.split("*"):
        result *= _of(values, name, side)
    return result
