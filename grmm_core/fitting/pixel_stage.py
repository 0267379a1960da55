"""Tracking on pixels: camera, pose, gaze, expression and shape from the whole picture, after landmarks have started them.

A quick avatar of the photos (eq. 19 in few steps) is drawn as tracked. Where a point of its skin or lips differs from
the photo, the difference over the picture's gradient is the shift that would mend it (Lucas and Kanade 1981): such shifts,
along the gradient only, are further terms of the landmarks' least squares, as is where the skin ends (`outline`), which
pixels inside it hardly tell. All unknowns are solved together, from coarse to fine. Both pictures are compared without what
varies slowly, for light and skin tone are not known exactly. The round whose pictures agree best is kept, if they do so better
than before, and the landmarks do not contradict it.

Called by `api` and the evaluation. Imports torch.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from ..controls.names import ALIGNED_NAMES
from ..geometry.triangles import vertex_normals
from ..geometry.zbuffer import triangle_depth
from ..head import HeadModel
from ..jobs.progress import Share, nobody, within
from ..model.grmm import GRMM
from ..model.weights_file import WeightsInfo
from ..photo.parser import parse
from ..pictures.sampling import bilinear
from .blurring import blurred
from .code_stage import Codes, code_prior, fit_codes
from .landmark_stage import LandmarkFit, finished, restarted, with_shape
from .objective import decode, draw, relit
from .person_lights import found_lights, trust_in
from .photo_targets import FitView, bare_pixels, fit_view
from .photometric_stage import outline_terms
from .point_rig import LandmarkRig, PointRig
from .presets import CodeSettings
from .recoloring import PhotoLight, recolor
from .solver import Term, solve
from .surface import Surface, texel_surface
from .track import appearance_of
from .types import PhotoTrack

logger = logging.getLogger(__name__)

QUICK = CodeSettings(192, 96, 12, 1, 0, 12)
"""Of the avatar that is compared."""
SIDE = 384  # pixels of the pictures that are compared
BLURS = (3.0, 2.0, 1.2)  # pixels, one for each round
SLOW = 16.0  # pixels: what varies more slowly is light or tone
ITERATIONS = 2  # of the least squares in each round
POINTS = 5000  # texels that are looked at
COLOR_SIGMA = (0.04, 0.028)  # expected difference of lightness and of red less green
REACH = 4.0  # pixels that a point is believed to be off by
FLAT = 2e-3  # gradient below which a point tells nothing
NOISE = 4.0  # a real face differs from any the model knows: expected errors grow with what the pictures differ by
HAIRY = 0.15  # of a pixel: brows and beards from which on it is not compared, for the drawn head has none
FACING = 0.25  # cosine between normal and view from which a point is compared
HIDDEN = 0.003  # metres behind the mesh's depth that still are its surface
MOST_LANDMARK_LOSS = 0.03  # eye distances by which the mean landmark error may grow: faces are off by 0.02 as it is
_REGIONS = ("face", "lips", "ears")  # eyes are where the landmarks are exact, and people differ most
_NOT = ("mouth_interior", "lashes", "lids")
_GREY, _INSIDE = 0.5, 0.9
_QUICK_SHARE = 0.5  # of the time


def track_pixels(
    tracks: Sequence[PhotoTrack], model: GRMM, info: WeightsInfo, *, progress: Share | None = None
) -> list[PhotoTrack]:  # fmt: skip
    """Track photos of one person again, by all their pixels.

    Args:
        tracks: By landmarks.
        model: Trained model whose head they were tracked with; it is not changed.
        info: What the weights file says.
        progress: Called with 0..1; may raise to cancel.

    Returns:
        Tracks of the same pictures, or `tracks` where the pixels tell nothing better.
    """
    told = progress or nobody
    head = model.head_model
    if head.landmarks478 is None or not model.config.residuals:
        return list(tracks)
    rig = LandmarkRig(head)
    # what a pixel shows does not change while the head moves by a pixel or two: the parser is asked once
    labelled = [replace(track, labels=np.stack(astuple(parse(track, head)))) for track in tracks]
    appearance = _Appearance(labelled, model, info, within(told, 0.0, _QUICK_SHARE))
    moved = _rounds(labelled, appearance, rig, within(told, _QUICK_SHARE, 1.0))
    if moved is labelled or not _believed(moved, tracks):
        return list(tracks)
    identity = appearance.codes.z_id.cpu().numpy()
    return [replace(track, labels=old.labels, identity=identity) for track, old in zip(moved, tracks, strict=True)]


def _believed(moved: Sequence[PhotoTrack], tracks: Sequence[PhotoTrack]) -> bool:
    """Whether the landmarks do not contradict where the photos were moved to."""
    worse = max(new.landmark_error - old.landmark_error for new, old in zip(moved, tracks, strict=True))
    logger.debug("pixels: landmark error grows by %.4f", worse)
    return worse <= MOST_LANDMARK_LOSS


def _rounds(tracks: list[PhotoTrack], appearance: _Appearance, rig: LandmarkRig, told: Share) -> list[PhotoTrack]:
    """Tracks of the round that agrees best with pictures of the avatar; `tracks` where none does better."""
    fit, now, best = restarted(tracks, rig), tracks, tracks
    differences: list[float] = []
    pictures = [appearance_of(track, rig.head) for track in tracks]
    for number, blur in enumerate((*BLURS, None)):
        told(number / (len(BLURS) + 1))
        looks = [appearance.look(track, index) for index, track in enumerate(now)]
        judged = [appearance.compared(look, BLURS[0]) for look in looks]  # all rounds by the same blur
        if not all(len(found.target) for found in judged):
            return tracks
        difference = sum(found.difference for found in judged) / len(judged)
        best = now if difference < min(differences, default=np.inf) else best
        differences.append(difference)
        if blur is None:  # the last round is judged only
            break
        compared = judged if blur == BLURS[0] else [appearance.compared(look, blur) for look in looks]
        photos = tuple(
            replace(
                photo, terms=(*photo.terms, found.term(rig.head, now[index]), *outline_terms(fit, index, pictures[index], rig))
            )
            for index, (photo, found) in enumerate(zip(fit.problem.photos, compared, strict=True))
        )
        problem = replace(fit.problem, photos=photos)
        solution = solve(problem, fit.solution, ITERATIONS)
        fit = finished(fit.problem, with_shape(problem, solution, ITERATIONS), fit.units, rig)
        now = [_moved(track, fit, index) for index, track in enumerate(tracks)]
    logger.debug("pixels: differences %s", differences)
    return best


@dataclass(frozen=True)
class Compared:
    """Points of a head and where the pixels say that they are.

    Attributes:
        triangles: [N].
        barycentric: [N, 3].
        target: Pixels of the compared picture, [N, 2].
        normals: Unit directions along which that holds, [N, 2].
        sigma: Expected error, pixels, [N].
        difference: Root of the mean square of what the pictures differ by at all points.
        view: The compared picture.
    """

    triangles: np.ndarray
    barycentric: np.ndarray
    target: np.ndarray
    normals: np.ndarray
    sigma: np.ndarray
    difference: float
    view: FitView

    def term(self, head: HeadModel, track: PhotoTrack) -> Term:
        """A term of the least squares, in pixels of the whole photo."""
        own, photo = self.view.camera, track.photo_camera
        scale = photo.fx / own.fx
        target = (self.target - [own.cx, own.cy]) * scale + [photo.cx, photo.cy]
        return Term(PointRig(head, self.triangles, self.barycentric), target, self.sigma * scale, self.normals)


class _Look(NamedTuple):
    """What is compared.

    Attributes:
        view: The photo.
        number: The photo's.
        shown: The avatar over grey, [H, W, 3].
        photo: The photo likewise.
        bare: 1 at pixels of skin, [H, W].
        pixels: Where the points are, [P, 2].
        told: Points that are seen on bare skin, [N].
    """

    view: FitView
    number: int
    shown: np.ndarray
    photo: np.ndarray
    bare: np.ndarray
    pixels: np.ndarray
    told: np.ndarray


class _Points(NamedTuple):
    """Texels that are looked at: their triangles [P] and barycentric coordinates [P, 3]."""

    triangles: np.ndarray
    barycentric: np.ndarray


def _points(model: GRMM) -> _Points:
    """Texels of the regions that are compared, evenly fewer than there are."""
    head = model.head_model
    corners = head.faces[model.layout.face]
    chosen = np.flatnonzero((head.marked(*_REGIONS) & ~head.marked(*_NOT))[corners].all(1))
    if len(chosen) > POINTS:
        chosen = np.sort(np.random.default_rng(0).choice(chosen, POINTS, replace=False))
    return _Points(model.layout.face[chosen], np.asarray(model.layout.barycentric, np.float64)[chosen])


class _Appearance:
    """What the photos' person looks like, as far as a quick search tells."""

    def __init__(self, tracks: Sequence[PhotoTrack], model: GRMM, info: WeightsInfo, told: Share) -> None:
        self.model, head = model, model.head_model
        self.surface: Surface = texel_surface(model)
        views = self.views(tracks, SIDE)
        pictures = [(view.camera, view.image.cpu().numpy(), bare_pixels(view)) for view in views]
        _, ratios, doubt = found_lights(head, model.layout, tracks, pictures)
        self.light = PhotoLight.of(model, ratios, trust_in(doubt))
        small, large = ([view.through_lenses() for view in self.views(tracks, side)] for side in (QUICK.small_side, QUICK.side))
        was = [parameter.requires_grad for parameter in model.parameters()]
        model.requires_grad_(False)
        try:
            prior = code_prior(info, model)
            with torch.enable_grad():
                self.codes: Codes = fit_codes(
                    model, prior, large, small, self.surface, self.light, QUICK, lambda share, _: told(share)
                )
        finally:
            for parameter, needed in zip(model.parameters(), was, strict=True):
                parameter.requires_grad_(needed)
        self._points = _points(model)

    def views(self, tracks: Sequence[PhotoTrack], side: int, first: int = 0) -> list[FitView]:
        """The photos at a size."""
        model = self.model
        return [
            fit_view(
                track, model.head_model, first + i, side, len(ALIGNED_NAMES), model.dtype, model.device, model.config.hairless
            )
            for i, track in enumerate(tracks)
        ]  # fmt: skip

    @torch.no_grad()
    def drawn(self, view: FitView) -> tuple[np.ndarray, np.ndarray]:
        """The person as tracked over grey, in the photo's light, [H, W, 3], and the posed vertices, [V, 3]."""
        model = self.model
        inputs = self.codes.inputs(model, view)
        vertices, decoded = model.mesh(inputs).vertices, decode(model, inputs, view.camera)
        lit = self.light.picture(model, view, vertices, decoded)
        colored = decoded.recolored(recolor(decoded.colors, self.codes.maps, self.surface))
        picture = relit(draw(model, view.camera, vertices, colored), lit).over((_GREY,) * 3)
        return picture.image.cpu().numpy(), vertices.cpu().numpy().astype(np.float64)

    def look(self, track: PhotoTrack, index: int) -> _Look:
        """A photo, and the avatar drawn as it is tracked."""
        view = self.views([track], SIDE, index)[0]
        shown, vertices = self.drawn(view)
        cover = view.mask.cpu().numpy()[..., None]
        photo = view.image.cpu().numpy() * cover + _GREY * (1.0 - cover)
        bare = ((view.measured * view.clear).cpu().numpy() > 0.5).astype(np.float32)  # where light ends is no feature
        bare *= _hairless(track, view, self.model.head_model)
        return _Look(view, index, shown, photo, bare, *self._visible(view, vertices, bare))

    def compared(self, look: _Look, blur: float) -> Compared:
        """Compare a photo with the avatar, both smoothed by so many pixels."""
        view, number, shown, photo, bare, pixels, told = look
        ours, theirs = _fast_part(shown, bare, blur), _fast_part(photo, bare, blur)
        points, targets, normals, sigmas, squares = [], [], [], [], []
        for channel, sigma in enumerate(COLOR_SIGMA):
            down, right = np.gradient(0.5 * (ours[channel] + theirs[channel]))
            gradient = bilinear(np.stack([right, down], -1), pixels[told])
            off = bilinear((theirs[channel] - ours[channel])[..., None], pixels[told])[:, 0]
            steep = np.linalg.norm(gradient, axis=1)
            use = steep > FLAT
            normal = gradient[use] / steep[use, None]
            shift = np.clip(-off[use] / steep[use], -REACH, REACH)
            points.append(told[use])
            targets.append(pixels[told[use]] + shift[:, None] * normal)
            normals.append(normal)
            sigmas.append(sigma / steep[use])
            squares.append((off / sigma) ** 2)
        every = np.concatenate(points)
        difference = float(np.sqrt(np.mean(np.concatenate(squares)))) if len(every) else 0.0
        return Compared(
            self._points.triangles[every], self._points.barycentric[every], np.concatenate(targets), np.concatenate(normals),
            np.concatenate(sigmas) * max(1.0, NOISE * difference) / float(self.light.trust[number].sqrt()), difference, view,
        )  # fmt: skip

    def _visible(self, view: FitView, vertices: np.ndarray, bare: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the points are in the picture, [P, 2], and those that are seen on bare skin, [N] indices."""
        camera, faces = view.camera, self.model.head_model.faces
        corners, weights = faces[self._points.triangles], self._points.barycentric[..., None]
        places = (vertices[corners] * weights).sum(1)
        normals = (vertex_normals(vertices, faces)[corners] * weights).sum(1)
        local, pixels = camera.project(places)
        rays = places - camera.position
        facing = -(normals * rays).sum(1) / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
        columns = np.clip(pixels[:, 0].astype(int), 0, camera.width - 1)
        rows = np.clip(pixels[:, 1].astype(int), 0, camera.height - 1)
        surely = blurred(bare[None], BLURS[-1])[0] > _INSIDE
        seen = (pixels > 2.0).all(1) & (pixels < [camera.width - 2, camera.height - 2]).all(1) & (facing > FACING)
        near = local[:, 2] < triangle_depth(vertices[faces], camera)[rows, columns] + HIDDEN
        return pixels, np.flatnonzero(seen & near & surely[rows, columns])


def _moved(track: PhotoTrack, fit: LandmarkFit, index: int) -> PhotoTrack:
    """A track with what was solved for; the working picture stays."""
    before, after = track.photo_camera, fit.cameras[index]
    scale = track.camera.fx / before.fx
    origin = np.array([before.cx - track.camera.cx / scale, before.cy - track.camera.cy / scale])
    camera = replace(
        track.camera, world_to_camera=after.world_to_camera, fx=after.fx * scale, fy=after.fy * scale,
        cx=(after.cx - origin[0]) * scale, cy=(after.cy - origin[1]) * scale,
    )  # fmt: skip
    view = fit.views[index]
    return replace(
        track, camera=camera, photo_camera=after, shape=fit.shape, expression=view.expression, pose=view.pose,
        landmarks_fitted=(fit.landmarks[index] - origin) * scale,
    )  # fmt: skip


def _hairless(track: PhotoTrack, view: FitView, head: HeadModel) -> np.ndarray:
    """1 at the pixels of a view that are away from brows and beard, [H, W]."""
    parts = parse(track, head)
    hairy = blurred(np.asarray(parts.brows + parts.beard, np.float32)[None], BLURS[0])[0]
    own, whole = view.camera, track.camera
    rows, columns = np.mgrid[: own.height, : own.width] + 0.5
    scale = whole.fx / own.fx
    places = np.stack([(columns - own.cx) * scale + whole.cx, (rows - own.cy) * scale + whole.cy], -1)
    clear: np.ndarray = bilinear(hairy[..., None], places)[..., 0] < HAIRY
    return clear.astype(np.float32)


def _fast_part(picture: np.ndarray, bare: np.ndarray, blur: float) -> np.ndarray:
    """Lightness and red less green, smoothed, without what varies slowly over the bare pixels, [2, H, W]."""
    planes = np.stack([picture.mean(-1), picture[..., 0] - picture[..., 1]]).astype(np.float32)
    slow = blurred(planes * bare, SLOW) / (blurred(bare[None], SLOW) + 1e-3)
    return blurred(planes, blur) - slow
