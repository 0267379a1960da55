"""Frames of a video file, upright and no larger than landmarks need. Needs PyAV."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ..errors import FileFormatError
from ..pictures.recordings import open_video, pyav

MAX_SIDE = 1280  # pixels: a face that fills a third of it is still finer than the landmark network's 256
MAX_SECONDS = 3600.0
DEFAULT_FPS = 30.0
_QUARTER = 90.0  # degrees
_REMEDY = "open it in a player, and save it again as MP4 if it plays"


class VideoFile:
    """An opened video. Use it as a context manager.

    Attributes:
        path: The file.
        fps: Frames a second that the file states; 30 where it states none.
        duration: Seconds that it states, or None.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open a file.

        Raises:
            FileAccessError: It is missing or may not be read.
            FileFormatError: It is no video, or longer than an hour.
            RuntimeMissingError: PyAV is not installed.
        """
        self.path = Path(path)
        self._container: Any = open_video(self.path, _REMEDY)
        self._stream = self._container.streams.video[0]
        self._stream.thread_type = "AUTO"
        rate = self._stream.average_rate or self._stream.guessed_rate
        self.fps = float(rate) if rate and 1.0 <= rate <= 1000.0 else DEFAULT_FPS
        length = self._container.duration
        self.duration = None if not length or length < 0 else length / pyav().time_base
        if self.duration is not None and self.duration > MAX_SECONDS:
            self._container.close()
            raise FileFormatError(
                f"{self.path.name} is {self.duration / 60.0:.0f} minutes long; cut it to at most {MAX_SECONDS / 60.0:.0f}."
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._container.close()

    def frames(self, start: float = 0.0, end: float | None = None) -> Iterator[tuple[float, np.ndarray]]:
        """Seconds from the beginning and pixels [H, W, 3] uint8 of each frame from `start` to `end`, once.

        A frame that begins half of its length before or after these counts as on time.

        Raises:
            FileFormatError: Not even the first frame can be read. A damaged end is left out.
        """
        first: float | None = None
        shown, late = 0, 0.5 / self.fps
        try:
            for frame in self._container.decode(self._stream):
                time = shown / self.fps if frame.time is None else float(frame.time)
                first = time if first is None else first
                time, shown = time - first, shown + 1
                if end is not None and time > end + late:
                    return
                if time > MAX_SECONDS:
                    return
                if time >= start - late:
                    yield time, self._pixels(frame)
        except (pyav().FFmpegError, OSError, ValueError, MemoryError) as error:
            if not shown:
                raise FileFormatError(f"{self.path} is a damaged video; {_REMEDY}.") from error

    def _pixels(self, frame: Any) -> np.ndarray:
        """Display pixels of a frame: scaled down, and turned as phones say that they were held."""
        factor = min(1.0, MAX_SIDE / max(frame.width, frame.height))
        width, height = (max(2, round(side * factor)) for side in (frame.width, frame.height))
        pixels = frame.to_ndarray(width=width, height=height, format="rgb24")
        return np.ascontiguousarray(np.rot90(pixels, round(frame.rotation / _QUARTER)))  # both count against the clock
