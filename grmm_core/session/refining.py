"""The refinement network on one picture of several avatars (eq. 14).

The depth channel is min-max normalised over each avatar, as in training, by giving
every pixel the range of the avatar that covers most of it. Avatars of the same weights are refined in one pass over the joint
picture. Where weights differ, each network runs on the joint picture with the features of its own avatars, and its change is
blended in by their coverage: I = I_rgb + sum_g (I_g - I_rgb) c_g / alpha. With one set of weights this is eq. 14 itself.

Networks run on the covered part of the picture only, with a margin as wide as they see, which changes nothing in it.

One text for every engine: its arrays are numpy's or torch's. Called by `compose`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.libraries import Array, library_of, present, zeros
from ..model.config import GRMMConfig
from ..model.steps import depth_range, refinement_grid, refinement_margin
from ..splat.types import RasterOutput
from .passes import ROUNDING, Channels, strands_of
from .values import RAW_LINEAR_PASS, RenderOptions

if TYPE_CHECKING:
    from ..model.store import Model

_OF_RAW = {"raw", RAW_LINEAR_PASS}  # passes of the picture before it is refined
_ROWS_MIN = 32  # of a picture, in a task of a thread
_MIN_SKIN = 2e-3  # cover of skin between strands that is not worth refining


def refine(
    networks: Sequence[Model | None],
    raster: RasterOutput[Any],
    channels: Channels,
    options: RenderOptions,
    check: Callable[[], None],
) -> Any:
    """Return the refined colors, premultiplied over black, [H, W, 3]; where nobody asks for the raster's, in their place.

    Args:
        networks: Of each instance in the picture, None of a cloud; in the order of their channels of coverage.
        raster: The joint picture.
        channels: What rides along with it.
        options: Passes that are asked for, and whether it is a preview.
        check: Called before each network; raises where the picture is cancelled.
    """
    coarse = options.coarse
    coverage = None if channels.coverage is None else present(raster.features)[..., channels.coverage]  # [H, W, K]
    limits = depth_range(raster.depth, raster.alpha) if coverage is None else _ranges(raster, coverage)
    result = raster.rgb
    models: dict[int, Model] = {id(model): model for model in networks if model is not None}
    mixed = len({id(model) for model in networks}) > 1  # several weights, or clouds that no network may touch
    for key, model in models.items():
        check()
        if not model.config.refine:
            continue
        share = None  # of the cover that is this network's
        if mixed:
            mine = [k for k, own in enumerate(networks) if own is model]
            share = present(coverage)[..., mine].sum(-1)  # [H, W]
        if channels.skin is not None:  # no network has seen strands: they stay as they are
            share = _without_strands(raster, channels.skin, share)
        region = covered_region(raster.alpha if share is None else share, model.config, coarse)
        if region is None:
            continue
        rows, columns = region
        part = RasterOutput(
            rgb=raster.rgb[rows, columns],
            alpha=raster.alpha[rows, columns],
            depth=raster.depth[rows, columns],
        )
        own = channels.features[key]
        if raster.halves is None:
            part.features = present(raster.features)[rows, columns, own]
        else:
            first = channels.count - channels.last
            small_rows, small_columns = (slice(side.start // 2, -(-side.stop // 2)) for side in region)
            part.halves = raster.halves[small_rows, small_columns, own.start - first : own.stop - first]
        cover = None if share is None else library_of(share).minimum(share[rows, columns], part.alpha)
        refined = model.refine(part, limits if limits.ndim == 1 else limits[:, rows, columns], coarse, cover)
        if result is raster.rgb and (mixed or set(options.passes) & _OF_RAW):
            result = raster.rgb + 0.0
        result[rows, columns] = result[rows, columns] + (refined - part.rgb) if mixed else refined
    return result


def _without_strands(raster: RasterOutput[Any], skin: int, share: Any) -> Any:
    """What strands leave of a share of the cover, or of all of it, where that is worth refining, [H, W]."""
    if share is not None or not isinstance(raster.alpha, np.ndarray):
        left = (raster.alpha if share is None else share) - strands_of(raster, skin) - _MIN_SKIN
        return library_of(left).clip(left, 0.0, None)
    from ..compute.threads import for_rows
    from .cover_kernels import skin_cover

    cover = np.empty_like(raster.alpha)
    planes = raster.alpha, present(raster.features)[..., skin]
    for_rows(skin_cover, len(cover), *planes, ROUNDING, _MIN_SKIN, cover, smallest=_ROWS_MIN)
    return cover


def _ranges(raster: RasterOutput[Any], coverage: Any) -> Any:
    """Return, at each pixel, the depth range of the avatar that covers most of it, [2, H, W]."""
    owner = coverage.argmax(-1)  # [H, W]
    limits = zeros((2, *owner.shape), raster.depth)
    for k in range(coverage.shape[-1]):
        mine = owner == k
        limits[:, mine] = depth_range(raster.depth, raster.alpha * mine)[:, None]
    return limits


def covered_region(cover: Array, config: GRMMConfig, coarse: bool = False) -> tuple[slice, slice] | None:
    """Return rows and columns around everything covered, on the network's grid, with a margin; None when nothing is."""
    scale = 2 if coarse else 1
    multiple, margin = scale * refinement_grid(config), scale * refinement_margin(config)
    bounds = []
    for axis in (1, 0):
        library = library_of(cover)
        hit = library.argwhere(library.amax(cover, axis) > 0)
        if not len(hit):
            return None
        low, high = int(hit[0][0]), int(hit[-1][0]) + 1
        low = max(low - margin, 0) // multiple * multiple
        high = min(-(-(high + margin) // multiple) * multiple, cover.shape[1 - axis])
        bounds.append(slice(low, high))
    return bounds[0], bounds[1]
