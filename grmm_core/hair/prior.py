"""A prior over hairstyles: a code of few numbers that gives grooms between those it has seen. Numpy; heights need numba.

A groom is described by guides: at fixed roots spread over the scalp, the course of the hair around there without its curls, as
offsets from the root on the mean head, and how dense hair is; for the whole head how it curls, lies in locks and strays.
Styles of one kind lie near each other, so a few principal components of many grooms hold most of it (as in Perm, He et al.
2025, whose components are those of strands). From guides, strands are interpolated: between neighbours that go the same way,
so that a parting stays one; all known grooms are parted on one side, and half of the draws are mirrored.

`python -m tools.hair_prior` learns it from the capture studio's styles.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ConfigError, ShapeError
from ..files.npz import read_npz
from ..head import HeadModel, load_open_head
from .body import Body
from .grids import nearest
from .groom import Groom, bind
from .mirror import mirrored
from .packaged import HEAD
from .roots import SCALP
from .strands import across, evened, lengths_of, smoothed

PRIOR_FILE = Path(__file__).resolve().parent.parent / "assets" / "hair_prior.npz"
POINTS = 16  # of a guide, the root among them
NEAR = 5  # strands or guides that are looked at around a root
WIDE = 0.009  # metres: how far around a root they count
ALIKE = 0.008  # metres by which the courses of two neighbours may differ that are mixed; a quarter of their length more
DENSE = 0.05  # metres that full density counts in the components, a root; scalars are of the size of all guides
SCALARS = ("curl_radius", "curl_turns", "locks", "frizz")
SCALAR_SIZE = np.array([0.008, 60.0, 1.0, 0.004])  # of each: metres, turns per metre, 0..1, metres
SCALAR_SHARE = 0.3  # of a coordinate of all guides that a scalar of its size counts
STRANDS, STRAND_POINTS = 6000, 32
CROPPED, CROPPED_POINTS, MOST = 0.05, 12, 3.0  # metres of mean length below which there are more strands, so many times at most
THICKNESS = 0.00007  # metres, of a head of `HAIRS`
HAIRS = 100_000
BORDER = 0.5  # of the thickness that hairs have at the hairline
WOUND = 0.12  # of a strand's length: radius of its curls at most
LOCKS = 420
GATHER = 1.5  # exponent of the place along a strand by which it joins its lock
LONGER = 1.5  # factor at most by which what lies between courses of several directions is too short
ALONE = 0.015  # metres to the next hairs' tips at which a strand is a stray one
FACE, FEW = np.array([(-0.045, -0.08, 0.06), (0.045, 0.045, 0.2)]), 0.04  # metres; so small a share of hair there strays
# metres of the mean head before and below which hair is the forehead's, and over which that begins; how far it stands off,
# how much more for curls of a radius, and how much of what is beyond is left
BROW, CROWN, FALLEN, CURLS, STIFF = (0.06, 0.02), (0.14, 0.02), 0.01, 5.0, 0.2
FALLS = 3  # rounds of that: `Body` tells heights of some centimetres
SHORT, LONG = 0.012, 0.05  # metres: shorter hair lies in no locks, hair so much longer does
KERNEL = 5  # known grooms among which one is drawn
HALF_LIFE = 0.3  # how far, of the way to another one, draws go at most
_PLASTIC, _THIRD = 0.7548776662466927, 0.5698402909980532  # steps of evenly spread places


@dataclass(frozen=True)
class Description:
    """A groom as the prior sees it.

    Attributes:
        guides: Offsets from the root on the mean head, metres, [G, POINTS - 1, 3].
        density: 0..1 [G].
        scalars: Of the head, see `SCALARS`, [4].
    """

    guides: np.ndarray
    density: np.ndarray
    scalars: np.ndarray

    @property
    def length(self) -> float:
        """Of the hair in the mean, metres."""
        steps = np.linalg.norm(np.diff(self.guides, axis=1, prepend=0.0), axis=2).sum(1)
        return float((steps * self.density).sum() / max(float(self.density.sum()), 1e-6))

    def vector(self) -> np.ndarray:
        """All of it as one row [D], in metres or what counts as much."""
        weight = np.sqrt(self.guides[..., 0].size)
        parts = self.guides.ravel(), DENSE * self.density, SCALAR_SHARE * weight * WIDE * self.scalars / SCALAR_SIZE
        return np.concatenate(parts)

    @staticmethod
    def of_vector(row: np.ndarray, count: int) -> Description:
        """The opposite, for `count` guides."""
        end = count * (POINTS - 1) * 3
        weight = np.sqrt(count * (POINTS - 1))
        guides = row[:end].reshape(count, POINTS - 1, 3)
        scalars = np.maximum(row[end + count :] / (SCALAR_SHARE * weight * WIDE) * SCALAR_SIZE, 0.0)
        return Description(guides, np.clip(row[end : end + count] / DENSE, 0.0, 1.0), scalars)


@dataclass(frozen=True)
class HairPrior:
    """The prior of a head.

    Attributes:
        triangles: Number of the head's triangle under each guide, [G].
        weights: Barycentric coordinates of the guides, [G, 3].
        growth: How dense hair grows at each vertex of the head, 0..1, fading out at the hairline, [V].
        mean: Mean description, [D].
        basis: Principal components, one standard deviation each, [C, D].
        codes: Of the grooms that it was learned from, [S, C].
        head: Whose guides these are.
    """

    triangles: np.ndarray
    weights: np.ndarray
    growth: np.ndarray
    mean: np.ndarray
    basis: np.ndarray
    codes: np.ndarray
    head: HeadModel

    @property
    def size(self) -> int:
        """Numbers of a code."""
        return len(self.basis)

    def draw(self, seed: int) -> np.ndarray:
        """A code at random: somewhere between a groom that was seen and others like it, [C]."""
        g = np.random.default_rng(seed)
        own = self.codes[g.integers(len(self.codes))]
        near = np.argsort(((self.codes - own) ** 2).sum(1))[1 : 1 + KERNEL]
        shares = g.dirichlet(np.ones(len(near))) * g.uniform(0.0, HALF_LIFE) if len(near) else np.zeros(0)
        return (own + shares @ (self.codes[near] - own)).astype(np.float32)

    def describe(self, code: np.ndarray) -> Description:
        """What a code says. Raises `ShapeError` for one of another size."""
        code = np.asarray(code, float)
        if code.shape != (self.size,) or not np.isfinite(code).all():
            raise ShapeError(f"A hair code has the shape {code.shape} or is not finite; {self.size} numbers are needed.")
        return Description.of_vector(self.mean + code @ self.basis, len(self.triangles))

    def code(self, groom: Groom) -> np.ndarray:
        """The code that comes nearest to a groom of this head, [C] float32. Raises `ShapeError`."""
        some = groom.select(groom.groups == SCALP)
        if not len(some):
            raise ShapeError("The groom has no scalp hair; a hair code is about that alone.")
        frames = some.frames(self.head.v_template, self.head.faces)
        even = some.resampled(STRAND_POINTS)
        strands = even.posed(frames, np.asarray(self.head.v_template, float)).reshape(len(some), STRAND_POINTS, 3)
        return self.code_of(self.described(strands))

    def code_of(self, description: Description) -> np.ndarray:
        """The code that comes nearest to a description, [C] float32."""
        off = description.vector() - self.mean
        return (self.basis @ off / (self.basis**2).sum(1)).astype(np.float32)

    def described(self, strands: np.ndarray) -> Description:
        """Describe strands [N, K, 3] on the mean head, root first, of even steps."""
        return described(self.places, strands)

    @functools.cached_property
    def places(self) -> np.ndarray:
        """Where the guides stand on the mean head, [G, 3] metres."""
        corners = np.asarray(self.head.v_template, float)[np.asarray(self.head.faces)[self.triangles]]
        return (corners * self.weights[..., None]).sum(1)

    def groom(
        self, code: np.ndarray, length: float = 1.0, curl: float = 1.0, volume: float = 1.0, density: float = 1.0
    ) -> Groom:
        """Make the groom of a code.

        Args:
            code: [C], standard deviations along the components.
            length: Factor of all lengths, 0.1..2.
            curl: Factor of the radius of curls, 0..2.
            volume: Factor of the height above the skin, 0.3..2.
            density: Share of the strands, 0.05..1.
        """
        found = self.describe(code)
        g = np.random.default_rng(11)
        guides = np.concatenate([np.zeros((len(found.guides), 1, 3)), found.guides], 1) * np.clip(length, 0.1, 2.0)
        mean = float(lengths_of(guides).mean())
        count = int(STRANDS * np.clip(CROPPED / max(mean, 1e-6), 1.0, MOST))  # what is short covers little
        steps = STRAND_POINTS if mean > CROPPED else CROPPED_POINTS
        triangles, weights, roots = self._roots(count, g)
        border = (self.growth[np.asarray(self.head.faces)[triangles]] * weights).sum(1)
        order, near = nearest(self.places, roots, NEAR)
        share = mixed(guides[:, 1:], order, near)
        keep = g.random(count) < (share * found.density[order]).sum(1) * border**2 * np.clip(density, 0.05, 1.0)
        order, share, roots, border = order[keep], share[keep], roots[keep], border[keep]
        if not len(roots):
            raise ShapeError("A hair code gave a head without a hair; use one nearer to 0.")
        offsets = np.concatenate([np.zeros((len(roots), 1, 3)), between(guides[:, 1:], order, share)], 1)
        points = roots[:, None] + evened(offsets * np.clip(g.normal(1.0, 0.08, (len(roots), 1, 1)), 0.7, 1.3), steps)
        points = _in_locks(points, float(found.scalars[2]), int(LOCKS * count / STRANDS), g)
        points = _curled(points, found.scalars * [np.clip(curl, 0.0, 2.0), 1.0, 1.0, 1.0], g)
        body = Body.of(self.head, np.asarray(self.head.v_template, float))
        if volume != 1.0:
            heights, up = body.heights(points[:, 1:].reshape(-1, 3))
            lift = (np.clip(volume, 0.3, 2.0) - 1.0) * np.clip(heights, 0.0, 0.03)
            points[:, 1:] += (lift[:, None] * up).reshape(len(points), -1, 3)
        points = body.pushed(_fallen(points, body, float(found.scalars[0])))
        company = np.ones(len(points), bool)
        if steps == STRAND_POINTS:  # what is short cannot stray
            company = nearest(points[:, -1], points[:, -1], NEAR)[1][:, -1] < ALONE
            before = ((points > FACE[0]) & (points < FACE[1])).all(2).any(1)
            if before.mean() < FEW:
                company &= ~before
        points, keep = points[company], np.flatnonzero(keep)[company]
        width = THICKNESS * HAIRS / count * (BORDER + (1.0 - BORDER) * border[company])
        template, faces, left = np.asarray(self.head.v_template, float), np.asarray(self.head.faces), len(points)
        return bind(
            template, faces, template, triangles[keep], weights[keep], points.reshape(-1, 3).astype(float),
            np.arange(left + 1) * steps, width[:, None] * [1.0, 0.45], np.full(left, SCALP),
        )  # fmt: skip

    def _roots(self, count: int, g: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Triangles, weights and places of roots, evenly by area where hair grows; those that follow each other are near."""
        faces, template = np.asarray(self.head.faces), np.asarray(self.head.v_template, float)
        among = np.flatnonzero(self.growth[faces].max(1) > 0)
        corners = template[faces[among]]
        cells = ((corners.mean(1) - template.min(0)) / WIDE).astype(int)
        curve = sum((cells[:, axis] >> bit & 1) << (3 * bit + axis) for bit in range(6) for axis in range(3))  # Morton's
        order = np.argsort(curve, kind="stable")
        among, corners = among[order], corners[order]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        at = (np.arange(count) + g.random(count)) / count
        chosen = np.minimum(np.searchsorted(np.cumsum(area / area.sum()), at), len(among) - 1)
        a, b = np.sqrt(np.arange(count) * _PLASTIC % 1.0), np.arange(count) * _THIRD % 1.0
        weights = np.stack([1 - a, a * (1 - b), a * b], 1)
        return among[chosen], weights, (corners[chosen] * weights[..., None]).sum(1)


def _fallen(points: np.ndarray, body: Body, radius: float) -> np.ndarray:
    """Strands [N, K, 3], curled by a radius, that fall on the forehead: halfway from one groom to another they are a visor."""
    most, fallen = FALLEN + CURLS * radius, points.copy()
    for _ in range(FALLS):
        heights, up = body.heights(fallen[:, 1:].reshape(-1, 3))
        height, depth = fallen[:, 1:, 1].ravel(), fallen[:, 1:, 2].ravel()
        before = ((depth - BROW[0]) / BROW[1]).clip(0.0, 1.0) * ((CROWN[0] - height) / CROWN[1]).clip(0.0, 1.0)
        down = before * (1.0 - STIFF) * (heights - most).clip(0.0)
        fallen[:, 1:] -= (down[:, None] * up).reshape(len(points), -1, 3)
    return fallen


def described(places: np.ndarray, strands: np.ndarray) -> Description:
    """Describe strands [N, K, 3] on the mean head by guides at places [G, 3]."""
    straight = smoothed(strands)
    straight = straight + smoothed(strands - straight)  # bends around the head stay, curls do not
    order, near = nearest(strands[:, 0], places, NEAR)
    offsets = evened(straight, POINTS)[:, 1:] - strands[:, :1]
    guides = between(offsets, order, mixed(offsets, order, near))
    apart = np.median(nearest(strands[:, 0], strands[:: max(1, len(strands) // 500), 0], 2)[1][:, 1])
    density = np.clip(1.5 - (near[:, 1] / max(apart, 1e-6)) / 4.0, 0.0, 1.0)
    own = (strands - straight)[:, strands.shape[1] // 3 :]
    radius = np.sqrt((own**2).sum(2).mean(1))
    length = lengths_of(straight)
    side = (own * across(straight)[0][:, strands.shape[1] // 3 :]).sum(2)
    turns = 0.75 * (np.diff(np.sign(side), axis=1) != 0).sum(1) / np.maximum(length, 0.01)  # of two thirds of it
    tips = strands[:, -1]
    some = slice(None, None, max(1, len(strands) // 500))
    locks = 1.0 - np.median(nearest(tips, tips[some], 2)[1][:, 1]) / max(apart, 1e-6) / 2.0
    rough = np.linalg.norm(np.diff(strands, 3, axis=1), axis=2).mean(1) if strands.shape[1] > 3 else np.zeros(len(strands))
    step = np.minimum(2 * np.pi * turns * length / (strands.shape[1] - 1), np.pi)
    rough = rough - radius * (2.0 * np.sin(0.5 * step)) ** 3  # what curls alone would give
    frizz = np.clip(np.median(rough), 0.0, 0.004)
    scalars = np.array([np.median(radius), np.median(turns), np.clip(locks, 0.0, 1.0), frizz])
    return Description(guides, density, scalars)


def mixed(courses: np.ndarray, order: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Shares [P, k] of neighbouring courses [N, points, 3] at places: of near ones that go the way of the nearest one."""
    some = courses[order][:, :, [courses.shape[1] // 3, -1]]
    off = np.linalg.norm(some - some[:, :1], axis=3).max(2)
    slack = ALIKE + 0.25 * np.linalg.norm(some[:, :1, -1], axis=2)
    share = np.exp(-((near / WIDE) ** 2) - (off / slack) ** 2) + 1e-9
    return share / share.sum(1, keepdims=True)


def between(courses: np.ndarray, order: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Courses [P, points, 3] between those [N, points, 3] at places with shares [P, k]: as long as they are on average."""
    mean = np.einsum("nk,nkpc->npc", share, courses[order])
    long = (share * lengths_of(courses)[order]).sum(1)
    own = lengths_of(mean)
    return mean * np.clip(long / np.maximum(own, 1e-6), 1.0, LONGER)[:, None, None]


def _in_locks(points: np.ndarray, strength: float, count: int, g: np.random.Generator) -> np.ndarray:
    """Draw strands [N, K, 3] towards the leader of their lock, of so many, more and more along them."""
    leaders = g.choice(len(points), min(count, len(points)), replace=False)
    own = leaders[nearest(points[leaders, 0], points[:, 0] + g.normal(0, 0.002, (len(points), 3)), 1)[0][:, 0]]
    t = np.linspace(0, 1, points.shape[1])[None, :, None] ** GATHER
    length = np.linalg.norm(points[:, -1] - points[:, 0], axis=1)
    pull = np.clip(strength, 0.0, 0.95) * np.clip((length - SHORT) / LONG, 0.0, 1.0)
    pull = pull * (np.linalg.norm(points[own, -1] - points[:, -1], axis=1) < 0.5 * length + 0.01)
    return points + pull[:, None, None] * t * (points[own] - points)


def _curled(points: np.ndarray, scalars: np.ndarray, g: np.random.Generator) -> np.ndarray:
    """Wind strands [N, K, 3] to curls, out of step with each other, and let them stray."""
    radius, turns, _, frizz = scalars
    count = points.shape[1]
    t = np.linspace(0, 1, count)[None]
    length = lengths_of(points)[:, None]
    lock = nearest(points[:: max(1, len(points) // LOCKS), -1], points[:, -1], 1)[0]
    phase = 6.0 * np.sin(97.0 * lock) + g.normal(0, 0.4, (len(points), 1))
    angle = 2 * np.pi * np.minimum(turns * length, count / 4.0) * t + phase
    side, other = across(points)
    ramp = (np.minimum(t * 4.0, 1.0) * np.minimum(radius, WOUND * length))[..., None]
    points = points + ramp * (np.cos(angle)[..., None] * side + np.sin(angle)[..., None] * other)
    stray = g.normal(0, 1, (len(points), 1, 3)) * np.sin(np.pi * (2 + 3 * g.random((len(points), 1, 1))) * t[..., None])
    return points + frizz * t[..., None] * stray


@functools.lru_cache(maxsize=1)
def hair_prior() -> HairPrior:
    """The prior of the open head. Raises `FileAccessError`."""
    arrays = read_npz(PRIOR_FILE)[0]
    basis = arrays["basis"].astype(np.float32) * arrays["basis_step"][:, None]
    return HairPrior(
        arrays["triangles"], arrays["weights"].astype(np.float64), arrays["growth"] / 255.0, arrays["mean"].astype(np.float64),
        basis.astype(np.float64), arrays["codes"].astype(np.float64), load_open_head(),
    )  # fmt: skip


@functools.lru_cache(maxsize=8)
def random_groom(seed: str, head: str = HEAD) -> Groom:
    """The groom of a seed as users write it, for a head model by name. Raises `ConfigError`, `ShapeError` for another head."""
    if head != HEAD:
        raise ShapeError(f"Hair at random is for the head {HEAD}, not {head}; wear it on an avatar of that head.")
    if not (seed.isascii() and seed.isdigit() and len(seed) < 10):
        raise ConfigError(f"random:{seed[:20]} does not name hair at random; write a number, for example random:7.")
    prior = hair_prior()
    groom = prior.groom(prior.draw(int(seed)))
    return mirrored(groom, prior.head) if np.random.default_rng([int(seed), 2]).integers(2) else groom
