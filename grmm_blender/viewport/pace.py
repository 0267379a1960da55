"""Which level of detail holds the frame rate. Plain Python; the clock is the caller's.

The time from a changed scene to new Gaussians is measured for each level. While something moves, the finest level within the
time of a frame is used; if none is, the mesh alone is shown, which Blender moves by itself.
"""

from __future__ import annotations

from ...grmm_core.session import MAX_LOD

_SMOOTHING = 0.5  # weight of the newest measurement
_SLACK = 1.2  # a level that takes this much longer than a frame still counts as keeping up


class Pace:
    """Measured times of one viewport."""

    def __init__(self) -> None:
        self._seconds: dict[int, float] = {}
        self._warm = False

    def record(self, level: int, seconds: float) -> None:
        """Note how long Gaussians of a level took. The very first time is left out: it includes loading the model."""
        if not self._warm:
            self._warm = True
            return
        known = self._seconds.get(level, seconds)
        self._seconds[level] = known + _SMOOTHING * (seconds - known)

    def level(self, finest: int, budget: float) -> int | None:
        """Return the level of detail for something that moves, None for the mesh alone.

        Args:
            finest: The level that the user chose.
            budget: Seconds that a frame may take.
        """
        for level in range(finest, MAX_LOD + 1):
            # What was never tried is tried.
            if self._seconds.get(level, 0.0) <= budget * _SLACK:
                return level
        return None

    def forget(self) -> None:
        """Try everything again: other avatars are shown, or a new playback begins."""
        self._seconds.clear()
