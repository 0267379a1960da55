"""What scene meshes leave to be seen of avatars: their depth, kept between pictures, against that of the avatars.

Plain numpy on plain values, on any thread; `pipeline` calls it. Drawing tens of thousands of triangles takes a fifth of a
picture's time. Where neither meshes nor camera have changed, what was drawn for the picture before is used again; where they
have, it is drawn on a thread while the session draws the avatars. Both know beforehand neither which part of the picture the
avatars cover nor how far they reach, so they take what the picture before covered and draw the rest when it turns out to be
needed: a part has the very values of the whole, so that no picture depends on what was drawn earlier.
"""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from ...grmm_core.geometry.camera import Camera
from ...grmm_core.geometry.libraries import present
from ...grmm_core.geometry.zbuffer import EMPTY, Window, mean_of_samples, triangle_depth
from ...grmm_core.session import EMPTY_DEPTH
from ..scene.shot import Occluder, Occluders

BUDGET = 128 << 20  # bytes of depths that are kept after a picture
_MARGIN = 1 / 8  # of the side of a part, drawn beyond what the avatars of the picture before needed
_FAR_MARGIN = 1.1  # likewise, of the distance

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Visibility:
    """What scene meshes leave of avatars and background.

    Attributes:
        avatars: Visible part of the avatars in each pixel, 0..1, [H, W, 1]; None where nothing hides them.
        part: Rows and columns outside of which nothing hides them.
        background: Part of the background that no holdout object covers, 0..1, [H, W, 1]; None for all of it.
    """

    avatars: np.ndarray | None = None
    part: tuple[slice, slice] = (slice(None), slice(None))
    background: np.ndarray | None = None


@dataclass(frozen=True)
class _Need:
    """A part of a picture, and how far meshes matter there, metres."""

    window: Window
    far: float

    def covers(self, other: _Need) -> bool:
        """Whether what was drawn for this need is enough for the other."""
        (x0, y0, x1, y1), (left, top, right, bottom) = self.window, other.window
        return x0 <= left and y0 <= top and x1 >= right and y1 >= bottom and self.far >= other.far

    def widened(self, camera: Camera, farthest: float) -> _Need:
        """Return more than this, within the camera's picture."""
        x0, y0, x1, y1 = self.window
        x, y = round((x1 - x0) * _MARGIN) + 1, round((y1 - y0) * _MARGIN) + 1
        window = max(x0 - x, 0), max(y0 - y, 0), min(x1 + x, camera.width), min(y1 + y, camera.height)
        return _Need(window, min(self.far * _FAR_MARGIN, farthest))


class _Drawn:
    """Depths of the meshes of one picture in a part of it."""

    def __init__(self, scene: _Scene, need: _Need) -> None:
        """Draw them."""
        self.scene, self.need = scene, need  # the scene holds the meshes: their identity stays theirs
        self.plain = scene.draw(scene.occluders.plain, need)
        self.holdouts = scene.draw(scene.occluders.holdouts, need) if scene.occluders.holdouts else None
        self.nearest = self.plain if self.holdouts is None else np.minimum(self.plain, self.holdouts)
        samples = scene.samples
        height, width = self.nearest.shape
        self._grid = self.nearest.reshape(height // samples, samples, width // samples, samples)
        planes = [self._grid[:, row, :, column] for row in range(samples) for column in range(samples)]
        self._low, self._high = functools.reduce(np.minimum, planes), functools.reduce(np.maximum, planes)

    @property
    def size(self) -> int:
        """Bytes."""
        arrays = {id(array): array.nbytes for array in (self.plain, self.holdouts, self.nearest) if array is not None}
        return sum(arrays.values()) + self._low.nbytes + self._high.nbytes

    def visible(self, depth: np.ndarray, window: Window) -> np.ndarray:
        """Return which part of each pixel of `window` no mesh covers before `depth` [h, w]; 0..1, [h, w] float32.

        Most pixels lie wholly before or wholly behind the meshes; samples are compared in the others only.
        """
        rows, columns = self._place(window)
        result = (self._low[rows, columns] > depth).astype(np.float32)
        y, x = np.nonzero((result == 0) & (self._high[rows, columns] > depth))
        seen = self._grid[y + rows.start, :, x + columns.start] > depth[y, x, None, None]  # [M, samples, samples]
        result[y, x] = seen.sum(axis=(1, 2), dtype=np.float32) / np.float32(self.scene.samples**2)
        return result

    def uncut(self, window: Window) -> np.ndarray:
        """Return which part of each pixel of `window` no holdout cuts out of the background, [h, w] float32."""
        rows, columns = self._place(window)
        return self._uncut[rows, columns]

    @functools.cached_property
    def _uncut(self) -> np.ndarray:
        holdouts = present(self.holdouts)
        cut = (holdouts < EMPTY) & (holdouts <= self.plain)
        grid = cut.reshape(self._grid.shape)
        return 1.0 - mean_of_samples(lambda row, column: grid[:, row, :, column], self.scene.samples)

    def _place(self, window: Window) -> tuple[slice, slice]:
        left, top = self.need.window[:2]
        return slice(window[1] - top, window[3] - top), slice(window[0] - left, window[2] - left)


@dataclass(frozen=True)
class _Scene:
    """Meshes as one camera sees them."""

    occluders: Occluders
    camera: Camera
    samples: int
    clip: tuple[float, float]

    @functools.cached_property
    def key(self) -> Hashable:
        """The same for the same picture, as long as the meshes live."""
        camera = self.camera
        lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, camera.orthographic)
        meshes = tuple(
            tuple((id(mesh.triangles), mesh.matrix.tobytes()) for mesh in part)
            for part in (self.occluders.plain, self.occluders.holdouts)
        )
        return meshes, camera.world_to_camera.tobytes(), lens, self.samples, self.clip

    def draw(self, meshes: tuple[Occluder, ...], need: _Need) -> np.ndarray:
        """Return the depth at each sample of a part."""
        triangles = np.concatenate([np.zeros((0, 3, 3), np.float32), *(mesh.placed() for mesh in meshes)])
        return triangle_depth(triangles, self.camera, self.samples, self.clip[0], need.far, need.window)


class OccluderDepths:
    """Depths of scene meshes, kept from picture to picture. One for final renders, one for each viewport."""

    def __init__(self, budget: int = BUDGET) -> None:
        """Keep up to `budget` bytes."""
        self._budget = budget
        self._lock = threading.Lock()  # a picture that was given up may still be drawing ahead
        self._kept: dict[Hashable, _Drawn] = {}  # the last used one at the end
        self._last: dict[tuple[int, int, int], _Need] = {}  # by size of the picture and samples
        self.drawn = 0  # times that meshes were drawn

    def of(self, occluders: Occluders, camera: Camera, samples: int, clip: tuple[float, float]) -> SceneDepths:
        """Begin with a picture; called before the avatars are drawn.

        Args:
            occluders: Meshes.
            camera: Camera of the whole picture.
            samples: Samples per pixel and direction along edges.
            clip: Nearest and farthest distance that the camera sees.
        """
        return SceneDepths(self, _Scene(occluders, camera, samples, clip))

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._kept.clear()
            self._last.clear()

    def begin(self, scene: _Scene) -> threading.Thread | None:
        """Draw on a thread what is not there and will probably be needed."""
        camera = scene.camera
        guess = self._last.get((camera.width, camera.height, scene.samples))
        if scene.key in self._kept or guess is None:
            return None
        need = guess.widened(camera, scene.clip[1])
        thread = threading.Thread(target=self._draw_ahead, args=(scene, need), name="GRMM scene depth", daemon=True)
        thread.start()
        return thread

    def get(self, scene: _Scene, need: _Need) -> _Drawn:
        """Return depths that cover the need."""
        camera = scene.camera
        self._last[camera.width, camera.height, scene.samples] = need
        with self._lock:
            found = self._kept.get(scene.key)
        if found is None or not found.need.covers(need):
            if found is not None:  # avatars move before a scene that stands: do not draw it anew for every step
                x0, y0, x1, y1 = found.need.window
                left, top, right, bottom = need.window
                window = min(x0, left), min(y0, top), max(x1, right), max(y1, bottom)
                need = _Need(window, max(need.far, found.need.far)).widened(camera, scene.clip[1])
            found = self._draw(scene, need)
        self._keep(found)
        return found

    def trim(self) -> None:
        """Drop what was not used for longest, until the budget is kept."""
        with self._lock:
            total = sum(each.size for each in self._kept.values())
            for key in list(self._kept):
                if total <= self._budget:
                    break
                total -= self._kept.pop(key).size

    def _draw(self, scene: _Scene, need: _Need) -> _Drawn:
        self.drawn += 1
        return _Drawn(scene, need)

    def _draw_ahead(self, scene: _Scene, need: _Need) -> None:
        try:
            self._keep(self._draw(scene, need))
        except (MemoryError, ArithmeticError, ValueError) as error:
            _log.debug("The scene could not be drawn ahead: %s", error)  # `get` draws it, and meets the same error

    def _keep(self, drawn: _Drawn) -> None:
        with self._lock:
            self._kept.pop(drawn.scene.key, None)
            self._kept[drawn.scene.key] = drawn


class SceneDepths:
    """The meshes of one picture; made by `OccluderDepths.of`."""

    def __init__(self, depths: OccluderDepths, scene: _Scene) -> None:
        """Begin to draw what will be needed."""
        self._depths, self._scene = depths, scene
        self._ahead = depths.begin(scene)

    def visibility(self, depth: np.ndarray, corner: tuple[int, int], film: bool) -> Visibility:
        """Compare the avatars' depth with that of the meshes.

        Args:
            depth: The avatars' depth, `EMPTY_DEPTH` where none is, [H, W]; a part of the picture.
            corner: Column and row of the picture at which that part begins.
            film: The background is drawn, so that holdouts matter beside the avatars too.
        """
        if self._ahead is not None:
            self._ahead.join()
        covered = depth < EMPTY_DEPTH
        cut_background = film and bool(self._scene.occluders.holdouts)
        box = bounds(covered)
        x, y = corner
        left, top, right, bottom = 0, 0, depth.shape[1], depth.shape[0]
        far = self._scene.clip[1]
        if not cut_background:  # only the part of the picture that avatars cover is of interest
            if box is None:
                return Visibility()
            left, top, right, bottom = box[1].start, box[0].start, box[1].stop, box[0].stop
            far = min(far, float(np.max(depth, where=covered, initial=0.0)))
        window = left + x, top + y, right + x, bottom + y
        drawn = self._depths.get(self._scene, _Need(window, far))
        self._depths.trim()
        uncut = drawn.uncut(window)[..., None] if cut_background else None
        seen = drawn.visible(depth[top:bottom, left:right], window)
        box = bounds((seen < 1.0) & covered[top:bottom, left:right])
        if box is None:
            return Visibility(background=uncut)
        place = slice(box[0].start + top, box[0].stop + top), slice(box[1].start + left, box[1].stop + left)
        avatars = np.ones((*depth.shape, 1), np.float32)
        avatars[(*place, 0)] = seen[box]
        return Visibility(avatars, place, uncut)


def bounds(flags: np.ndarray) -> tuple[slice, slice] | None:
    """Return the rows and columns that hold all set flags [H, W], None where none is set."""
    rows, columns = np.flatnonzero(flags.any(axis=1)), np.flatnonzero(flags.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
