"""What is asked of a performance from a voice: one record, checked in one place.

The command line and Blender's operator make a `SpeakRequest`; it travels as arguments of ``grmm speak`` through the job's
process to `api.speak`. Needs the standard library only.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError

OUTPUT_SUFFIX = ".json"
SUFFIXES = (".wav", ".mp3", ".m4a", ".flac", ".ogg", ".opus", ".aac", ".aiff")
"""Of files that are offered in file browsers; any file with sound that FFmpeg reads is taken, videos too."""
ENGLISH, OTHER = "english", "other"
LANGUAGES = (ENGLISH, OTHER)
MOST_STRENGTH = 2.0


@dataclass(frozen=True)
class SpeakRequest:
    """A performance for a recorded voice.

    Attributes:
        recording: The file, or a video with the voice.
        output: ARKit JSON file to write.
        text: What is said, in English; "" to let it be found.
        language: One of `LANGUAGES`. English is heard in words, others in single sounds.
        strength: Of the movements of lips and jaw, 0..2; closed lips close whatever it is.
        liveliness: Of brows, gaze and head, 0..2; 0 leaves only the mouth.
        seed: Equal numbers draw the same blinks and looks.
        start: First second that is used.
        end: Last second, or None for all.

    Raises:
        ConfigError: These values cannot be meant. Files are looked at when the work begins.
    """

    recording: Path
    output: Path
    text: str = ""
    language: str = ENGLISH
    strength: float = 1.0
    liveliness: float = 1.0
    seed: int = 0
    start: float = 0.0
    end: float | None = None

    def __post_init__(self) -> None:
        for name in ("recording", "output"):
            object.__setattr__(self, name, Path(getattr(self, name)))
        if self.output.suffix.lower() != OUTPUT_SUFFIX:
            raise ConfigError(f"{self.output.name} does not end in {OUTPUT_SUFFIX}; name the performance's file NAME.json.")
        if self.language not in LANGUAGES:
            raise ConfigError(f"There is no language {self.language}; choose one of {', '.join(LANGUAGES)}.")
        if self.text and self.language != ENGLISH:
            raise ConfigError("A text helps only with English; leave it out.")
        for name in ("strength", "liveliness"):
            if not 0.0 <= getattr(self, name) <= MOST_STRENGTH:
                raise ConfigError(f"The {name} is {getattr(self, name):g}; choose 0 to {MOST_STRENGTH:g}.")
        if self.seed < 0:
            raise ConfigError(f"The seed is {self.seed}; choose 0 or more.")
        if not 0.0 <= self.start < math.inf:
            raise ConfigError(f"A recording cannot be used from second {self.start:g}; give 0 or more.")
        if self.end is not None and not self.start < self.end:
            raise ConfigError(f"The last second ({self.end:g}) must come after the first ({self.start:g}).")

    def arguments(self) -> list[str]:
        """Arguments of ``grmm speak`` that ask for this."""
        result = [f"--output={self.output}", f"--language={self.language}", f"--strength={self.strength!r}"]
        result += [f"--liveliness={self.liveliness!r}", f"--seed={self.seed}", f"--start={self.start!r}"]
        result += [f"--text={self.text}"] if self.text else []
        result += [] if self.end is None else [f"--end={self.end!r}"]
        return [*result, "--", str(self.recording)]

    @staticmethod
    def from_arguments(parsed: argparse.Namespace) -> SpeakRequest:
        """What parsed arguments of ``grmm speak`` ask for. Raises `ConfigError`."""
        return SpeakRequest(
            parsed.recording, parsed.output, parsed.text, parsed.language, parsed.strength, parsed.liveliness, parsed.seed,
            parsed.start, parsed.end,
        )  # fmt: skip
