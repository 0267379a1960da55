"""Hair of the person in photos: the groom that they show, its pigments, brows, beard and lashes.

What no photo shows is the groom's; under a hat it is plain hair. The groom comes from `hair_match`, brows, beard and lashes
from `face_hair`; pigments are sought so that the drawn color is the photo's. Imports torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..avatar import Hair
from ..hair.coloring import HairView, WornHair, around_head, reduced, with_colors
from ..hair.groom import Groom, join
from ..hair.settings import HairSettings
from ..hair.strands import blocks_of
from .face_hair import face_hair
from .hair_grain import waves
from .hair_match import FINE_SIDE, OPACITY, SIDE, Stage, best_grooms, few, finished, wanted_waves
from .hair_shape import with_hairline
from .hair_view import hair_view, hardly_shown

if TYPE_CHECKING:
    from ..head import HeadModel
    from ..photo.parser import PhotoParts
    from .types import PhotoTrack

# matching grooms that are bent to the last millimetre before one is chosen, and how much less than the best's their score is at
# most: that changes by 0.06 more for one groom than for another (13 photos)
FINISHED, CLOSE = 3, 0.08
VARIATION = (0.3, 1.0)  # of the color from lock to lock, by how much the photo has
CURLS, CURLED = (0.0, 0.15, 0.3, 0.45, 0.6), 0.7  # settings to try, and which share of the waves is enough
LEAST_CURLED = 1.0  # radians, as of `hair_grain.waves`: hair with fewer waves is straight
LIGHTER = 0.2  # of melanin: by how much hair that hardly shows may be lighter than the brows


def person_hair(
    tracks: Sequence[PhotoTrack],
    parts: Sequence[PhotoParts],
    head: HeadModel,
    progress: Callable[[float], None] = lambda share: None,
) -> Hair:  # fmt: skip
    """Scalp hair, brows, beard and lashes of the person in tracked and parsed photos.

    Args:
        tracks: Photos.
        parts: What their pixels show.
        head: Whose mesh the strands stand on.
        progress: Hears the share that is done.
    """
    views = [hair_view(track, seen, head) for track, seen in zip(tracks, parts, strict=True)]
    scalp = fit_hair(views, head, progress)
    settings = HairSettings() if scalp is None else scalp.settings
    grooms, own = face_hair(tracks[0], parts[0], views[0], head, settings)
    if hardly_shown(views[0], parts[0]):
        settings = _like_brows(settings, own["brows"])
    return Hair(join(grooms if scalp is None or scalp.groom is None else [scalp.groom, *grooms]), settings, own)


def _like_brows(scalp: HairSettings, brows: HairSettings) -> HairSettings:
    """Settings of hair that hardly shows: if lighter than brows, then a little, and no greyer, whatever skin shines through."""
    melanin = max(scalp.melanin, brows.melanin - LIGHTER)
    return scalp.changed(melanin=melanin, grey=min(scalp.grey, brows.grey)) if melanin > scalp.melanin else scalp


def fit_hair(views: Sequence[HairView], head: HeadModel, progress: Callable[[float], None] = lambda share: None) -> Hair | None:
    """Return the groom that the photos show, with its settings; None for a bald head.

    Args:
        views: Photos of one person.
        head: Whose mesh the grooms stand on.
        progress: Hears the share that is done.
    """
    matches = best_grooms(views, head, progress)
    if not matches[0].name:
        return None
    stages = [Stage(around_head(view), head, FINE_SIDE) for view in views]
    likely = [match for match in matches[:FINISHED] if match.score >= matches[0].score - CLOSE]
    groom, length, _ = max((finished(match, stages, head) for match in likely), key=lambda made: made[2])
    groom = with_hairline(groom, stages, head)
    settings = with_colors(HairSettings(length=length, curl=_curl(groom, stages, head)), groom, views, head)
    return Hair(groom, _varied(settings, groom, around_head(views[0]), head))


def _varied(settings: HairSettings, groom: Groom, view: HairView, head: HeadModel) -> HairSettings:
    """Settings with as much variation of color as hair in a photo has beside that of the drawn strands."""
    scale = min(1.0, SIDE / max(view.hair.shape))
    height, width = (max(1, round(n * scale)) for n in view.hair.shape)
    camera = view.camera.resized(width, height)
    rgb, cover = WornHair(groom, settings, view.vertices, camera, head).drawn(settings)
    full = (np.minimum(cover, reduced(view.hair * view.counts, (height, width)))) > OPACITY
    if full.sum() < SIDE:
        return settings
    seen, drawn = (float(reduced(image.mean(2), (height, width))[full].std()) for image in (view.image, rgb))
    return settings.changed(variation=float(np.clip(settings.variation * seen / max(drawn, 1e-3), *VARIATION)))


def _curl(groom: Groom, stages: Sequence[Stage], head: HeadModel) -> float:
    """The least curl of the settings with which a groom is about as wavy as in the photos; 0 where these show no waves."""
    wanted = wanted_waves(stages)
    if wanted is None or wanted < LEAST_CURLED:
        return 0.0
    (block,) = blocks_of(few(groom), np.asarray(head.v_template), head.faces)[:1]
    return next((curl for curl in CURLS if waves(block.styled(HairSettings(curl=curl))) > CURLED * wanted), CURLS[-1])
