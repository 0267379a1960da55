"""From strands to what the rasteriser draws, for one picture: level of detail, pose, Gaussians, what the head hides, colors.

Called by sessions. Uses the compiled `strand_kernels`; the same for tensors and with gradients: `ribbons`, `gradients`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..geometry.zbuffer import EMPTY, triangle_depth
from .ribbons import OPACITY, Eye
from .roots import BROWS, LASHES, SCALP
from .settings import HairSettings
from .strands import StrandBlock, shortness

DRAWN = 0.6  # px: how wide a strand should be on the picture; thinner ones are drawn as fewer, wider ones
SPARSE = 0.2  # px: likewise for brows, beards, lashes and shorn hair, between which skin shows
SHORT, LONG = 0.008, 0.06  # metres: mean length of hair that is drawn so, and of hair that is not
SMALLEST_SHARE = 0.06  # of the strands
BUDGET = 110.0  # Gaussians a pixel per metre: as many as a picture of this size can be drawn of in good time
RAISED, RAISED_SHORN, MOST_RAISED = 0.001, 0.0045, 0.012  # metres: see `raised_by`
CELL = 6.0  # px: of the coarse depth that says what the head hides
SLACK = 0.006  # metres below the skin that still count as seen
COVERED = 6.0  # opacity of strands, summed up, that hides those behind: of curls, which lie unevenly, over 4 leaves holes
TELLING = 2500  # strands that tell for all what strands cover
HEAD_REACH = 0.25  # metres before and behind the head's origin in which that is counted
_MAX_CELLS = 128
_NEAR = 1e-4  # metres, as in `triangle_depth`
_STRANDS = 512  # of a task
_SHAPES: tuple[tuple[int, ...], ...] = ((3,), (4,), (3,), (), (3,), (1,))  # of a row of `StrandGaussians`


class StrandGaussians(NamedTuple):
    """Gaussians of strands, head space: means [N, 3], quats [N, 4], scales [N, 3], opacities [N], display sRGB [N, 3].

    And what each has of the light around it, which is in the colors (`StrandBlock.crowded`), [N, 1].
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    share: np.ndarray


@dataclass(frozen=True)
class Hiding:
    """Coarse depth of a head: what lies behind it is not drawn. See `strand_kernels.hide`."""

    depth: np.ndarray
    cell: float
    left: float
    top: float

    @staticmethod
    def of(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> Hiding:
        """Draw the head's triangles as `camera` (in head space) sees them, coarsely.

        Args:
            vertices: Posed, [V, 3].
            faces: Those that hide, [F, 3].
            camera: Of the picture.
        """
        from .hidden_kernels import farthest_around

        depth, cell = coarse_depth(vertices, faces, camera)
        result = np.empty_like(depth)
        size = float(np.cbrt(np.linalg.det(camera.world_to_camera[:3, :3])))
        farthest_around(depth, float(EMPTY), 1.0 / size, result)
        return Hiding(result, cell, -camera.cx, -camera.cy)

    @property
    def cells(self) -> tuple[np.float32, np.float32, np.float32]:
        """`cell`, `left` and `top` as the kernels read them."""
        return np.float32(self.cell), np.float32(self.left), np.float32(self.top)

    def hide(self, means: np.ndarray, eye: np.ndarray, seen: np.ndarray, slack: float = SLACK) -> None:
        """Set `seen` [N] of places [N, 3], float32, to 0 where skin is more than `slack` before them; `eye`: `Eye.numbers`."""
        self.hide_shown(_placed(means, eye), seen, slack)

    def hide_shown(self, shown: np.ndarray, seen: np.ndarray, slack: float = SLACK) -> None:
        """Likewise of places of `hidden_kernels.place`, [N, 4]."""
        from ..compute.threads import for_rows
        from .hidden_kernels import hide

        def some(low: int, high: int) -> None:
            hide(shown[low:high], self.depth, *self.cells, np.float32(slack), seen[low:high])

        for_rows(some, len(shown))


def coarse_depth(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, float]:
    """Depth of triangles in coarse cells of a camera's picture, [H, W] metres, `EMPTY` where none is; and a cell's pixels."""
    from .hidden_kernels import nearest_skin

    size = max(camera.width, camera.height)
    cell = max(CELL, size / _MAX_CELLS)
    columns, rows = int(np.ceil(camera.width / cell)), int(np.ceil(camera.height / cell))
    coarse = Camera(
        camera.world_to_camera, camera.fx / cell, camera.fy / cell, camera.cx / cell, camera.cy / cell, columns, rows,
        orthographic=camera.orthographic,
    )  # fmt: skip
    vertices, place = np.asarray(vertices), coarse.world_to_camera
    numbers = np.concatenate([
        place[:3, :3].ravel(), place[:3, 3], (coarse.fx, coarse.fy, coarse.cx, coarse.cy, coarse.orthographic, _NEAR),
    ])  # fmt: skip
    depth = np.empty((rows, columns), np.float32)
    if not nearest_skin(vertices, faces, numbers, float(EMPTY), depth):
        depth = triangle_depth(vertices[faces], coarse)  # which cuts what reaches behind the camera
    return depth, cell


def _placed(points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """What `hidden_kernels.place` says of points [N, 3], float32, [N, 4]."""
    from ..compute.threads import for_rows
    from .hidden_kernels import place

    shown = np.empty((len(points), 4), np.float32)
    for_rows(lambda low, high: place(points[low:high], eye, shown[low:high]), len(points))
    return shown


def level_shares(blocks: Sequence[StrandBlock], pixels_per_metre: float, finer: float = 1.0, lod: int = 0) -> list[float]:
    """Share of the strands of each block to draw of a head that is seen at a size: continuous in the size.

    Of the scalp `finer` times as many as in good time, as long as there are so many. Brows and lashes are the same at every
    level of detail: they are few, and a quarter of them, twice as wide, would be blots.
    """
    all_of_them = sum(len(block) * block.segments for block in blocks)
    fewer = pixels_per_metre / 4**lod
    most = finer * BUDGET * fewer / max(all_of_them, 1)
    shares = []
    for block in blocks:
        wide = float(block.widths.mean()) * (pixels_per_metre if block.group in (BROWS, LASHES) else fewer)
        long = float(np.clip((block.length - SHORT) / (LONG - SHORT), 0.0, 1.0)) if block.group == SCALP else 0.0
        share = wide / (SPARSE + long * (DRAWN - SPARSE))
        shares.append(min(finer * share, most) if block.group == SCALP else share)
    return [float(np.clip(share, SMALLEST_SHARE, 1.0)) for share in shares]


def raised_by(block: StrandBlock, lod: int) -> float:
    """How much nearer to the eye strands are drawn than they are, metres: what Gaussians of skin would cover, in patches.

    Those are shorn hair, by up to `RAISED_SHORN`, as far as a Gaussian of skin that is seen aslant reaches before its middle,
    and brows where Gaussians are fewer and larger, by `RAISED`; at each level of detail twice as much. Shorn hair by
    `MOST_RAISED` at most: ears stand farther out.
    """
    if block.group == SCALP:
        return min(RAISED_SHORN * 2**lod, MOST_RAISED) * float(shortness(np.asarray(block.length)))
    return RAISED * 2**lod if block.group == BROWS and lod else 0.0


def nearer(made: StrandGaussians, eye: Eye, metres: float) -> StrandGaussians:
    """The same Gaussians, moved towards an eye, which sees them where they were."""
    ahead = eye.rotation[2]
    way = np.broadcast_to(-ahead, made.means.shape) if eye.orthographic else -eye.translation @ eye.rotation - made.means
    return made._replace(means=made.means + np.float32(metres) * way / np.linalg.norm(way, axis=1, keepdims=True))


def strand_gaussians(
    block: StrandBlock, points: np.ndarray, axes: np.ndarray, settings: HairSettings, share: float,
    eye: Eye | None = None, hiding: Hiding | None = None, direction: np.ndarray | None = None, detail: float = 1.0,
    whole: bool = False, crowded: np.ndarray | None = None, evened: float = 1.0,
) -> StrandGaussians:  # fmt: skip
    """Return the Gaussians of a block, in the order of its strands.

    Args:
        block: The strands.
        points: Their parents in head space, [M, K, 3].
        axes: Of the parents' roots, as rows, [M, 3, 3].
        settings: What density, thickness, color and sheen depend on.
        share: Level of detail, 0..1.
        eye: From where they are seen; None for opacities without antialiasing.
        hiding: What the head hides, or None.
        direction: Without an eye, the unit vector towards it that colors are for, [3]; None is from the front.
        detail: Share of these strands that is drawn, see `StrandBlock.level`.
        whole: With all segments of the strands, those that are not seen with opacity 0; else without these.
        crowded: Of `StrandBlock.crowded`; None for strands that are as light as those around them.
        evened: Power of that: a strand that stands for others is their mean.
    """
    from ..compute.threads import TASKS, for_each, pieces
    from .strand_kernels import pose, segments_forward, shade_into

    radii, there, albedo = block.drawn(share, settings, detail)
    power = np.float32(settings.shading * evened)  # as `StrandBlock.lit`
    count, segments = len(there), block.segments
    owner = block.owner[:count]
    points, axes = (np.ascontiguousarray(part, np.float32) for part in (points, axes))
    numbers = _far(direction) if eye is None else eye.numbers()
    opacities, tints, open_ = OPACITY * there, block.tinted(settings.length), block.lit(settings)
    seen = np.ones((len(points), segments), np.float32)
    if hiding is not None:
        _hide(hiding, points, radii, opacities, numbers, seen)
    kept = np.full(count, segments) if whole else np.count_nonzero(seen, axis=1)[owner] * (opacities > 0)
    starts = np.concatenate([[0], np.cumsum(kept)])
    made = StrandGaussians(*(np.empty((starts[-1], *shape), np.float32) for shape in _SHAPES))
    parts = pieces(count, _STRANDS, TASKS)

    def draw(task: int) -> None:
        """Make the strands of a task, of which only what is seen is computed, where the processor's caches hold them."""
        low, high = parts[task]
        own = low + np.flatnonzero(kept[low:high])
        where = np.empty((len(own), segments + 1, 3), np.float32)
        light = np.empty((len(own), segments + 1, 4), np.float32)
        some = StrandGaussians(*(np.empty((len(own) * segments, *shape), np.float32) for shape in _SHAPES))
        some.opacities[:] = seen[owner[own]].ravel()
        pose(points, axes, owner[own], block.spread[own], open_, some.opacities, where, light)
        segments_forward(where, radii[own], opacities[own], numbers, eye is not None, *some[:4])
        share_of = some.share.reshape(len(own), segments)
        share_of[:] = 1.0 if crowded is None else crowded[own] ** power
        shade_into(where, albedo[own], light, share_of, some.opacities, numbers, settings.sheen, some.colors)
        if tints is not None:
            np.clip(some.colors + tints[owner[own]].reshape(-1, 3), 0.0, 1.0, out=some.colors)
        rows = np.arange(len(some.opacities)) if whole else np.flatnonzero(some.opacities)
        for array, result in zip(some, made, strict=True):
            np.take(array, rows, 0, out=result[starts[low] : starts[high]], mode="clip")

    for_each(len(parts), draw)
    return made


def _hide(
    hiding: Hiding, points: np.ndarray, radii: np.ndarray, opacity: np.ndarray, eye: np.ndarray, seen: np.ndarray
) -> None:
    """Set `seen` [M, K-1] to 0 of the segments of parents [M, K, 3] that the head hides, or other strands.

    Radii and opacities are those of the strands that are drawn, of which the first are the parents.
    """
    from ..compute.threads import for_rows
    from .hidden_kernels import LAYER, bury, thicken

    shown = _placed(points.reshape(-1, 3), eye).reshape(*points.shape[:2], 4)
    middles, flat = (0.5 * (shown[:, 1:] + shown[:, :-1])).reshape(-1, 4), seen.reshape(-1)
    hiding.hide_shown(middles, flat)
    some = slice(0, min(len(points), len(radii)), max(min(len(points), len(radii)) // TELLING, 1))
    told = [np.ascontiguousarray(part[some]) for part in (shown, radii, opacity, seen)]
    if not len(told[0]):
        return
    depths = told[0][..., 2]
    near = np.float32(max(depths.min(), eye[11] - HEAD_REACH))  # the head's origin is in the middle
    layers = int((min(depths.max(), eye[11] + HEAD_REACH) - near) / LAYER) + 2
    if layers < 2:
        return
    thick = np.zeros((*hiding.depth.shape, layers), np.float32)
    thicken(*told, np.float32(len(radii) / len(told[0])), *hiding.cells, near, thick)
    cover = *hiding.cells, near, thick, np.float32(COVERED)
    for_rows(lambda low, high: bury(middles[low:high], *cover, flat[low:high]), len(middles))


def _far(direction: np.ndarray | None) -> np.ndarray:
    """The numbers of an eye far away in a direction [3], for colors alone."""
    numbers = np.zeros(14, np.float32)
    numbers[6:9] = (0.0, 0.0, -1.0) if direction is None else -np.asarray(direction, np.float32)
    numbers[13] = 1.0
    return numbers
