"""From a recorded voice to a performance, in one call. Needs PyAV and pocketsphinx."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..controls.names import ARKIT_NAMES
from ..errors import FileAccessError, GrmmError
from ..formats.performances.arkit_json import write_arkit_json
from ..jobs.progress import Reporter
from ..jobs.stages import SPEAK
from ..performance import Performance
from .acting import act
from .listening import SILENCE, Heard, listen
from .mouth import mouth
from .request import ENGLISH, SpeakRequest
from .sound import RATE, loudness, read_sound

SOURCE = "voice"
FPS = 60.0
"""Frames a second of what is written: lips that close for three hundredths of a second are closed in one of them."""
_NAMED = 5  # unknown words that a message lists


@dataclass(frozen=True)
class Spoken:
    """What came of a voice.

    Attributes:
        performance: At a constant rate; its `warnings` say what was guessed.
        path: The file.
        heard: What is said.
    """

    performance: Performance
    path: Path
    heard: Heard


def speak(
    request: SpeakRequest,
    progress: Callable[..., None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Spoken:
    """Make the performance for a voice, and write it whole or not at all.

    Args:
        request: What is asked.
        progress: Called with `jobs.progress.Progress`.
        cancelled: Asked often; True ends the work.

    Raises:
        CancelledError: `cancelled` said so.
        FileAccessError, FileFormatError: The recording cannot be read, or the file not be written.
        GrmmError: Nobody speaks in it.
        RuntimeMissingError: PyAV or pocketsphinx is not installed.
    """
    reporter = Reporter(SPEAK, progress, cancelled)
    reporter("read", 0.0)
    if not request.output.parent.is_dir():
        raise FileAccessError(f"The folder {request.output.parent} does not exist; make it or choose another one.")
    samples = read_sound(request.recording, request.start, request.end)
    heard = listen(samples, request.text, request.language == ENGLISH, reporter.part("listen"))
    if all(phone.name == SILENCE for phone in heard.phones):
        raise GrmmError(f"Nobody is heard to speak in {request.recording.name}; choose a recording of a voice, without music.")
    reporter("act", 0.0)
    levels = loudness(samples)
    times = np.arange(max(1, round(len(samples) / RATE * FPS))) / FPS
    rest, turn = act(heard.phones, levels, times, request.liveliness, request.seed)
    weights = mouth(heard.phones, levels, times, request.strength) + rest
    performance = Performance(
        times, weights.clip(0.0, 1.0), FPS, SOURCE, tuple(ARKIT_NAMES), head_rotation=turn, warnings=_warnings(heard)
    )
    reporter.check()
    write_arkit_json(request.output, performance)
    reporter("act", 1.0)
    return Spoken(performance, request.output, heard)


def _warnings(heard: Heard) -> list[str]:
    result = []
    if heard.unknown:
        more = f" and {len(heard.unknown) - _NAMED} more" if len(heard.unknown) > _NAMED else ""
        result.append(f"How these words sound was guessed from their letters: {', '.join(heard.unknown[:_NAMED])}{more}.")
    if heard.unplaced:
        result.append("Parts of the text were not found in the recording; there, lips follow what is heard.")
    return result
