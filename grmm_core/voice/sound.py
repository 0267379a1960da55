"""Samples of a sound file, or of a video's sound, as speech recognition wants them; how loud they are. Needs PyAV."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FileAccessError, FileFormatError
from ..pictures.recordings import open_sound, pyav

RATE = 16_000
"""Samples a second."""
HOP = 0.01
"""Seconds between two values of `loudness`."""
MAX_SECONDS = 3600.0
_WINDOW = 0.04  # seconds over which loudness is meant: some periods of a low voice
_FLOOR = 1.0  # of 32767: silence is finite
_REMEDY = "open it in a player, and save it again as WAV if it plays"


def read_sound(path: Path, start: float = 0.0, end: float | None = None) -> np.ndarray:
    """Read a file's first sound track, mixed to one channel.

    Args:
        path: The file.
        start: First second.
        end: Last second, or None for all.

    Returns:
        Samples at `RATE`, [N] int16.

    Raises:
        FileAccessError: It is missing, may not be read, or ends before `start`.
        FileFormatError: It has no sound that can be read, or is longer than an hour.
        RuntimeMissingError: PyAV is not installed.
    """
    av = pyav()
    resampler = av.AudioResampler(format="s16", layout="mono", rate=RATE)
    first, most = round(start * RATE), round(MAX_SECONDS * RATE)
    last = most + 1 if end is None else min(round(end * RATE), most + 1)
    blocks: list[np.ndarray] = []
    read = 0
    with open_sound(path, _REMEDY) as container:
        try:
            for frame in container.decode(container.streams.audio[0]):
                frame.pts = None  # a damaged file's times run backwards; sound is what was decoded, in its order
                for block in resampler.resample(frame):
                    blocks.append(block.to_ndarray()[0])
                    read += len(blocks[-1])
                if read >= last:
                    break
        except (av.FFmpegError, OSError, ValueError, MemoryError) as error:
            if not blocks:
                raise FileFormatError(f"{path} is a damaged recording; {_REMEDY}.") from error
    samples = np.concatenate(blocks) if blocks else np.zeros(0, np.int16)
    if len(samples) > most:
        raise FileFormatError(f"{path.name} is longer than {MAX_SECONDS / 60.0:.0f} minutes; cut it.")
    if len(samples) <= first:
        raise FileAccessError(f"{path.name} is {len(samples) / RATE:.1f} s long; begin before second {start:g}.")
    return samples[first:last]


def loudness(samples: np.ndarray) -> np.ndarray:
    """Level in decibels every `HOP` seconds, [T]."""
    squares = np.concatenate([[0.0], np.cumsum(samples.astype(np.float64) ** 2)])
    centers = np.arange(0, len(samples), round(HOP * RATE))
    half = round(_WINDOW * RATE / 2)
    low, high = np.maximum(centers - half, 0), np.minimum(centers + half, len(samples))
    return 10.0 * np.log10((squares[high] - squares[low]) / (high - low) + _FLOOR)
