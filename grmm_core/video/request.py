"""What is asked of a performance capture: one record, checked in one place.

The command line and Blender's operator make a `TrackRequest`; it travels as arguments of ``grmm track`` through the job's
process to `api.track`. Needs the standard library only.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError

OUTPUT_SUFFIX = ".json"
SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
"""Of files that are offered in file browsers; any file that FFmpeg reads is taken."""


@dataclass(frozen=True)
class TrackRequest:
    """The performance of one face in a video of somebody who has agreed.

    Attributes:
        recording: The file, a video.
        output: ARKit JSON file to write.
        person: `.grmm` file of an avatar of the person in the video, whose shape is used; None finds the shape in the video.
        start: First second that is used.
        end: Last second, or None for all.
        face: Which face, counted from 0, the largest of the first frame that shows any first.
        threads: CPU threads; 0 leaves it to the libraries.

    Raises:
        ConfigError: These values cannot be meant. Files are looked at when the work begins.
    """

    recording: Path
    output: Path
    person: Path | None = None
    start: float = 0.0
    end: float | None = None
    face: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        for name in ("recording", "output"):
            object.__setattr__(self, name, Path(getattr(self, name)))
        object.__setattr__(self, "person", None if self.person is None else Path(self.person))
        if self.output.suffix.lower() != OUTPUT_SUFFIX:
            raise ConfigError(f"{self.output.name} does not end in {OUTPUT_SUFFIX}; name the performance's file NAME.json.")
        if not 0.0 <= self.start < math.inf:
            raise ConfigError(f"A video cannot be used from second {self.start:g}; give 0 or more.")
        if self.end is not None and not self.start < self.end:
            raise ConfigError(f"The last second ({self.end:g}) must come after the first ({self.start:g}).")
        if self.face < 0:
            raise ConfigError(f"There is no face {self.face + 1}; the largest is 1.")
        if self.threads < 0:
            raise ConfigError(f"{self.threads} threads are not possible; use 1 or more, or 0 for all.")

    def arguments(self) -> list[str]:
        """Arguments of ``grmm track`` that ask for this."""
        result = [f"--output={self.output}", f"--start={self.start!r}", f"--face={self.face + 1}"]
        result += [] if self.person is None else [f"--person={self.person}"]
        result += [] if self.end is None else [f"--end={self.end!r}"]
        result += [f"--threads={self.threads}"] if self.threads else []
        return [*result, "--", str(self.recording)]

    @staticmethod
    def from_arguments(parsed: argparse.Namespace) -> TrackRequest:
        """What parsed arguments of ``grmm track`` ask for. Raises `ConfigError`."""
        return TrackRequest(
            parsed.video, parsed.output, parsed.person, parsed.start, parsed.end, parsed.face - 1, parsed.threads or 0
        )
