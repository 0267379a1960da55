"""How splats are shown so that the frame rate holds. Plain Python; the clock is the caller's.

There are several ways to show a scene: Gaussians in levels of detail, a small picture of the CPU rasteriser (`PICTURE`), which
a slow graphics card only has to stretch, and the mesh alone, which Blender moves by itself. What each costs is measured, in
making and in drawing. While something moves, the finest way within the time of a frame is used. Where Blender alone takes
longer than that, a way may take `SHARE` of Blender's own time, so that splats never cost more of the rate than a fifth.
"""

from __future__ import annotations

from ..grmm_core.session import MAX_LOD

PICTURE = MAX_LOD + 1
"""The way after the coarsest Gaussians."""
SHARE = 0.25  # of Blender's own time: a fifth less of its rate
_SMOOTHING = 0.5  # weight of the newest measurement
_FEWER = 2.0  # time of a level over that of the next: a quarter of the Gaussians, but they cover as many pixels
_DOUBTED = 0.995  # of a measured time, with each picture that is made in a coarser way
_FORGIVEN = 0.8  # of a measured time, with each beginning and end of a playback
_SLACK = 1.2  # a way that takes this much longer than a frame still counts as keeping up


class Pace:
    """Measured times of one viewport."""

    def __init__(self) -> None:
        self._made: dict[int, float] = {}
        self._shown: dict[int, float] = {}
        self._others: float | None = None
        self._begun: set[int] = set()

    def record(self, way: int, seconds: float) -> None:
        """Note how long making took. The very first time is left out: it includes loading the model."""
        if self._begun:
            self._made[way] = _smoothed(self._made.get(way), seconds)
        self._begun.add(way)

    def is_begun(self, way: int) -> bool:
        """Whether something was made in a way, so that the next need not compile for it."""
        return way in self._begun

    def doubt(self, way: int) -> None:
        """Count what making took in finer ways than this as a little less: a slow moment passes, and they are tried again."""
        for finer in range(way):
            if finer in self._made:
                self._made[finer] *= _DOUBTED

    def record_frame(self, way: int | None, seconds: float, others: float) -> None:
        """Note a frame of playback.

        Args:
            way: How it was shown, None for the mesh alone.
            seconds: What that took of the frame: waiting for what was made, and drawing to its end.
            others: What everything else took since the frame before.
        """
        if way is not None:
            self._shown[way] = _smoothed(self._shown.get(way), seconds)
        self._others = _smoothed(self._others, others)

    def level(self, finest: int, budget: float) -> int | None:
        """Return the level of detail for an edit, None where none is made in time.

        Args:
            finest: The level that the user chose.
            budget: Seconds that it may take.
        """
        return next((level for level in range(finest, PICTURE) if self._made.get(level, 0.0) <= budget * _SLACK), None)

    def way(self, finest: int, budget: float) -> int | None:
        """Return how to show a frame of playback, None for the mesh alone.

        What was never tried is tried, unless a finer level took so long that half of it is too much.

        Args:
            finest: The level that the user chose.
            budget: Seconds that a frame may take.
        """
        others, least = self._others or 0.0, 0.0
        allowed = max(budget * _SLACK - others, SHARE * others)
        for way in range(finest, PICTURE + 1):
            least = 0.0 if way == PICTURE else least / _FEWER
            shown = self._shown.get(way, 0.0)  # of what was made while nobody waited, Blender's drawing had its part
            if max(least, shown) <= allowed:
                return way
            least = max(least, shown)
        return None

    def forget(self) -> None:
        """A playback begins or ends: try again what was a little too slow, but not what a card cannot do at all."""
        self._made.clear()
        self._shown = {way: seconds * _FORGIVEN for way, seconds in self._shown.items()}


def _smoothed(known: float | None, seconds: float) -> float:
    return seconds if known is None else known + _SMOOTHING * (seconds - known)
