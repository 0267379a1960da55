"""Which groom a photo shows: silhouette, orientation and waves of the strands against those of the package's grooms.

Every groom is drawn on the tracked head at small size, both ways round and at several lengths. Those whose cover and whose
strands' directions agree best with the hair in all photos are bent to them (`hair_shape`). Imports torch.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from ..compute.recent import Recent
from ..geometry.camera import Camera
from ..geometry.zbuffer import EMPTY, triangle_depth
from ..hair.coloring import HairView, around_head, hiding_faces, reduced
from ..hair.groom import Groom
from ..hair.mirror import mirrored
from ..hair.packaged import groom_names, library_groom
from ..hair.ribbons import Eye, segments
from ..hair.roots import SCALP
from ..hair.strands import lengthened
from ..photo.parser import MESH_PARTS, part_map
from ..splat.api import rasterize_arrays
from ..splat.types import GaussianArrays
from .hair_grain import Directions, coiliness, coils, directions, waves, waviness
from .hair_shape import FINE, Course, bent, field_to, offsets
from .hidden_hair import as_flat
from .strays import without_strays

if TYPE_CHECKING:
    from ..head import HeadModel

SIDE, FINE_SIDE = 160, 256  # pixels: longer side of the pictures that grooms are compared with, and that one is fitted to
STRANDS, FINE_STRANDS = 900, 3000  # of a drawn candidate: enough for a silhouette, and for its last millimetres
POINTS = 10  # of each
GRAIN_POINTS = 24  # of a strand whose coils are counted
LENGTHS = (0.45, 0.6, 0.8, 1.0, 1.25)
FINER = (0.9, 1.0, 1.1)  # factors of the second round
BENT, UNBENT = 4, 0.5  # grooms that are bent to the photos, and weight of the score that they had before
LIKELY_BENT = 0.8  # of the best such score: with less, long hair cut short would be bent to any short hair
SHY = 0.4  # of the score for each metre from roots to tips: what a photo cannot show, as before the forehead, is short
# of the score for each metre by which hair behind ends more than so much higher than hair is seen to reach: where that is, the
# share of the hair that is lower, and the lowest height that counts, since what is below a bust's rim is not drawn
SHORTER, HIGHER, LOWEST, DEEPEST, RIM = 1.5, 0.05, 0.04, -0.2, -0.16
INSIDE = 1.5  # weight of pixels on the bald head more than beside it: a fringe is small, and seen first
BALD, BALD_HATTED = 0.012, 0.003  # of the head's pixels: less hair is none
HATTED = 0.5  # of the scalp's pixels: if more are hidden, the person wears a hat
UNDER_HATS = ("bob", "crop", "pixie")
LONG_UNDER_HATS = ("bob", "chest_length", "chest_waves", "layered", "long", "ringlets", "wavy_long")
LONG = 0.25  # of the head's pixels: if more are hair below a hat, that is long
OPACITY = 0.9  # of a strand
ORIENTATION = 0.35  # weight of the agreement of directions beside that of cover
TRIMMED = 0.1  # weight of cover beside a photo's hair once strands are bent: what hangs there is cut (`hair_trim`)
# of the score that strands lose which are e times as wavy as in the photos, or as little, and up to how often e: straight ones
# can be curled; radians of straight ones, those that noise makes in photos, and how many times more strands turn than is seen
WAVY, MOST_WAVY, LEAST_WAVES, NOISE, SEEN = 0.06, 0.7, 0.6, 0.14, 3.6
COILY = 0.3  # of the score that strands lose which are straight where the photos show coils
HARDLY = 0.05  # cover by hair of what is plain skin
BEHIND = 0.004  # metres below the skin that are still seen


class Match(NamedTuple):
    """A groom against the photos.

    Attributes:
        name: Of the package's groom; "" for a bald head.
        flipped: The other way round.
        length: As in `HairSettings`.
        score: Agreement, at most 1.
        field: That bends it to the photos, see `hair_shape`; None leaves it.
        agreement: Of cover and directions alone, in the score.
        waves: Of the groom, as of `hair_grain.waves`.
    """

    name: str
    flipped: bool
    length: float
    score: float
    field: torch.Tensor | None = None
    agreement: float = 0.0
    waves: float = 0.0


def best_grooms(
    views: Sequence[HairView], head: HeadModel, progress: Callable[[float], None] = lambda share: None
) -> list[Match]:  # fmt: skip
    """Compare all grooms with the photos, see `fit_hair`; the best first."""
    stages = [Stage(around_head(view), head) for view in views]
    hatted = min(stage.hidden for stage in stages) > HATTED
    if max(stage.share for stage in stages) < (BALD_HATTED if hatted else BALD):
        return [Match("", False, 1.0, 1.0)]
    long = max(stage.share for stage in stages) > LONG
    names = (LONG_UNDER_HATS if long else UNDER_HATS) if hatted else groom_names()
    tried: list[Match] = []
    for number, name in enumerate(names):
        progress(0.6 * number / len(names))
        both = (Candidate.of(name, flipped, head) for flipped in (False, True))
        tried.append(max((_judged(stages, candidate, length) for candidate in both for length in LENGTHS), key=_score))
    ranked = sorted(tried, key=_score, reverse=True)
    candidate = Candidate.of(ranked[0].name, ranked[0].flipped, head)
    best = max([ranked[0], *(_judged(stages, candidate, ranked[0].length * factor) for factor in FINER)], key=_score)
    if hatted and not long:
        return [best]
    found, likely = [], [match for match in ranked[1:BENT] if match.score > LIKELY_BENT * best.score]
    for number, match in enumerate([best, *likely]):
        progress(0.6 + 0.4 * number / BENT)
        candidate = Candidate.of(match.name, match.flipped, head)
        field = field_to(candidate.course(stages, match.length), stages)
        judged = _judged(stages, candidate, match.length, field)
        found.append(judged._replace(score=judged.score + UNBENT * match.score))
    progress(1.0)
    return sorted(found, key=_score, reverse=True)


def finished(match: Match, stages: Sequence[Stage], head: HeadModel) -> tuple[Groom, float, float]:
    """A matching groom bent to the photos, how long it is to be drawn, and its score by strands about as thin as drawn ones."""
    groom = library_groom(match.name, head.name)
    groom = mirrored(groom, head) if match.flipped else groom
    if match.field is None:
        return groom, match.length, match.score
    before, groom = groom, bent(groom, match.length, match.field, head)
    groom = bent(groom, 1.0, field_to(Strands(groom, head, FINE_STRANDS).course(stages, 1.0), stages, FINE), head)
    groom = without_strays(as_flat(groom, before, match.length, stages, head), before, head)
    thin = Strands(groom, head, FINE_STRANDS)
    score = match.score - match.agreement + _agreement(stages, thin.course(stages, 1.0), beyond=TRIMMED)
    return groom, 1.0, score + _waves_apart(match.waves, stages) - _waves_apart(waves(_even(few(groom))), stages)


def _score(match: Match) -> float:
    return match.score


class Strands:
    """A groom thinned out for silhouettes, its strands as much wider."""

    def __init__(self, groom: Groom, head: HeadModel, most: int, flipped: bool = False) -> None:
        self.template = np.asarray(head.v_template, np.float64)
        rows = np.flatnonzero(groom.groups == SCALP)
        kept = rows[np.argsort((np.arange(len(rows)) * 0.6180339887498949) % 1.0)[:most]]  # spread evenly
        thin = groom.select(np.sort(kept)).resampled(POINTS)
        thin = mirrored(thin, head) if flipped else thin
        self.local = thin.points.reshape(len(thin), POINTS, 3)
        self.frames = thin.frames(self.template, head.faces)
        self.radii = (0.5 * len(rows) / max(len(thin), 1)) * thin.widths.astype(np.float32)
        self._stood: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}  # every length stands on the same few heads

    def _standing(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Roots on a posed head, [N, 3], and the axes there, [N, 3, 3]."""
        known = self._stood.get(id(vertices))
        if known is None:
            known = self._stood[id(vertices)] = (vertices, *self.frames.at(vertices))
        return known[1:]

    def points(self, vertices: np.ndarray, length: float) -> np.ndarray:
        """Strands on a posed head, [N, K, 3]."""
        origin, axes = (part.astype(np.float32) for part in self._standing(vertices))
        posed: np.ndarray = np.matmul(lengthened(self.local, length), axes) + origin[:, None]
        return posed

    def course(self, stages: Sequence[Stage], length: float) -> Course:
        """Strands ready to be bent to photos."""
        rest = self._standing(self.template)[1]
        turns = [np.matmul(rest.transpose(0, 2, 1), self._standing(stage.vertices)[1]) for stage in stages]
        posed = [self.points(stage.vertices, length) for stage in stages]
        return Course(self.points(self.template, length), posed, turns, self.radii, OPACITY)


class Candidate(Strands):
    """A groom of the package."""

    def __init__(self, name: str, flipped: bool, head: HeadModel) -> None:
        groom = library_groom(name, head.name)
        super().__init__(groom, head, STRANDS, flipped)
        self.name, self.flipped = name, flipped
        strands = _even(few(groom))
        self.coils, self.waves = coils(strands), waves(strands)

    @staticmethod
    def of(name: str, flipped: bool, head: HeadModel) -> Candidate:
        """The same, made once: no photo has a part in it."""
        found = copy.copy(_CANDIDATES.get((name, flipped, head), lambda: Candidate(name, flipped, head)))
        found._stood = {}
        return found


_CANDIDATES: Recent[Candidate] = Recent(64)


def make_candidates(head: HeadModel) -> None:
    """Make every groom ready to be compared."""
    for name in groom_names():
        for flipped in (False, True):
            Candidate.of(name, flipped, head)


def few(groom: Groom) -> Groom:
    """Enough strands and points of a groom's scalp to see coils and waves."""
    rows = np.flatnonzero(groom.groups == SCALP)
    return groom.select(rows[:: max(1, len(rows) // STRANDS)]).resampled(GRAIN_POINTS)


def _even(groom: Groom) -> np.ndarray:
    """Strands [N, K, 3] of a groom whose strands have one number of points, each in the axes of its root."""
    return groom.points.reshape(len(groom), -1, 3)


class Stage:
    """A photo made ready to be compared with."""

    def __init__(self, view: HairView, head: HeadModel, side: int = SIDE) -> None:
        height, width = view.hair.shape
        scale = min(1.0, side / max(height, width))
        size = max(1, round(height * scale)), max(1, round(width * scale))
        self.camera = view.camera.resized(size[1], size[0])
        self.vertices = view.vertices
        self.counts = reduced(view.counts, size)
        self.hair = reduced(view.hair, size)
        cosine, sine = directions(view.image, view.hair)
        self.seen = Directions(reduced(cosine, size), reduced(sine, size))
        self.depth = triangle_depth(np.asarray(view.vertices)[hiding_faces(head)], self.camera)
        self.weights = self.counts * (1.0 + INSIDE * (self.depth < EMPTY))
        self.share = float((self.hair * self.counts).sum() / max((self.depth < EMPTY).sum(), 1))
        scalp = part_map(head, view.vertices, self.camera)[0] == tuple(MESH_PARTS).index("scalp")
        bald = _enlarged(self.depth < EMPTY, view.hair.shape)
        self.coily = coiliness(view.image, view.hair * view.counts, bald & (view.hair < HARDLY) & (view.counts > 0.5))
        self.wavy = waviness(view.image, view.hair * view.counts, Eye.of(view.camera).pixels_per_metre())
        self.hidden = float((1.0 - self.counts)[scalp].mean()) if scalp.any() else 0.0
        self.low = _lowest(self.camera, self.hair * self.counts)

    def drawn(self, points: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, Directions]:
        """Cover [H, W] and directions of strands [N, K, 3]."""
        camera = self.camera
        opacity = np.full(len(points), OPACITY, np.float32)
        made = segments(points, radii, opacity, Eye.of(camera))
        local, pixels = camera.project(made.means.reshape(-1, 3))
        column, row = (np.clip(pixels[:, k].astype(int), 0, size - 1) for k, size in ((0, camera.width), (1, camera.height)))
        hidden = local[:, 2] > self.depth[row, column] + BEHIND
        _, ahead = camera.project((points[:, 1:] * 0.51 + points[:, :-1] * 0.49).reshape(-1, 3))
        way = ahead - pixels
        angle = 2.0 * np.arctan2(way[:, 1], way[:, 0])
        features = np.stack([np.cos(angle), np.sin(angle)], 1).astype(np.float32)
        opacities = made.opacities.reshape(-1) * ~hidden
        gaussians = GaussianArrays(
            made.means.reshape(-1, 3), made.quats.reshape(-1, 4), made.scales.reshape(-1, 3), opacities,
            np.zeros((len(opacities), 3), np.float32), features,
        )  # fmt: skip
        picture = rasterize_arrays(gaussians, camera)
        return picture.alpha, Directions(picture.features[..., 0], picture.features[..., 1])


def _lowest(camera: Camera, hair: np.ndarray) -> float:
    """Height in head space, metres, that hair [H, W] reaches down to, as if it hung beside the head's middle."""
    rows, columns = np.nonzero(hair > 0.5)
    if not len(rows):
        return 0.0
    middle = camera.world_to_camera[:3, 3]
    depth = float(middle[2])
    at = np.stack([(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))], 1)
    heights = (at * depth - middle) @ camera.world_to_camera[:3, 1]
    return float(np.quantile(heights, LOWEST))


def _enlarged(mask: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """The nearest pixel's value at another size, [H, W]."""
    rows, columns = (np.arange(new) * old // new for new, old in zip(size, mask.shape, strict=True))
    chosen: np.ndarray = mask[rows[:, None], columns]
    return chosen


def _judged(stages: Sequence[Stage], candidate: Candidate, length: float, field: torch.Tensor | None = None) -> Match:
    course = candidate.course(stages, length)
    agreement = _agreement(stages, course, field)
    coily = [stage.coily for stage in stages if stage.coily is not None]
    straight = COILY * (1.0 - candidate.coils) * float(np.mean(coily)) if coily else 0.0
    rest = course.rest if field is None else course.rest + offsets(field, course.rest)
    ends = rest[:, -1] + np.maximum(RIM - rest[:, -1], 0.0) * (0.0, 1.0, 0.0)
    reach = float(np.linalg.norm(ends - rest[:, 0], axis=1).mean())
    behind = rest[:, 0, 2] < 0.0
    low = max(min(stage.low for stage in stages), DEEPEST) + HIGHER
    short = max(float(np.median(rest[behind, -1, 1])) - low, 0.0) if behind.any() else 0.0
    score = agreement - SHY * reach - SHORTER * short - straight - _waves_apart(candidate.waves, stages)
    return Match(candidate.name, candidate.flipped, length, score, field, agreement, candidate.waves)


def _waves_apart(strands: float, stages: Sequence[Stage]) -> float:
    """What strands with so many waves lose of their score; nothing where the photos tell nothing."""
    wanted = wanted_waves(stages)
    return 0.0 if wanted is None else WAVY * min(abs(float(np.log(max(strands, LEAST_WAVES) / wanted))), MOST_WAVY)


def wanted_waves(stages: Sequence[Stage]) -> float | None:
    """Waves of strands, as of `hair_grain.waves`, that look like those of the photos; None where these tell nothing."""
    seen = [stage.wavy for stage in stages if stage.wavy is not None]
    return max(SEEN * (float(np.mean(seen)) - NOISE), LEAST_WAVES) if seen else None


def _agreement(stages: Sequence[Stage], course: Course, field: torch.Tensor | None = None, beyond: float = 1.0) -> float:
    """How far strands cover what the photos show as hair, and lie along its strands, at most 1; `beyond` weighs other cover."""
    scores = []
    for stage, posed, turn in zip(stages, course.posed, course.turns, strict=True):
        points = posed if field is None else posed + np.matmul(offsets(field, course.rest), turn).astype(np.float32)
        cover, way = stage.drawn(points, course.radii)
        both = np.minimum(cover, stage.hair) * stage.weights
        either = (stage.hair + beyond * np.maximum(cover - stage.hair, 0.0)) * stage.weights
        overlap = float(both.sum() / max(either.sum(), 1e-6))
        clear = np.hypot(*stage.seen) * np.hypot(*way) * stage.counts
        agree = (stage.seen.cosine * way.cosine + stage.seen.sine * way.sine) * stage.counts
        turned = float(agree.sum() / max(clear.sum(), 1e-6)) if clear.sum() > 1.0 else 0.0
        scores.append((overlap + ORIENTATION * overlap * turned) / (1.0 + ORIENTATION))
    return float(np.mean(scores))
