"""Videos that tests make: frames encoded on the spot, and what phones write into their headers."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

_IDENTITY = b"".join(value.to_bytes(4, "big") for value in (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30))
_QUARTER = b"".join(value.to_bytes(4, "big") for value in (0, 1 << 16, 0, (1 << 32) - (1 << 16), 0, 0, 0, 0, 1 << 30))


def write_video(path: Path, frames: Iterable[np.ndarray], fps: int = 15, times: Iterable[float] | None = None) -> Path:
    """Encode frames [H, W, 3] uint8, shown at `times` in seconds or one after the other."""
    import av

    ticks = None if times is None else [round(time * 1000) for time in times]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "16", "preset": "veryfast"}
        if ticks is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for index, pixels in enumerate(frames):
            if index == 0:
                stream.height, stream.width = pixels.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            if ticks is not None:
                frame.pts, frame.time_base = ticks[index], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def turned_by_a_quarter(path: Path, output: Path) -> Path:
    """A copy whose header says that the phone was held upright: players turn its pictures clockwise."""
    data = path.read_bytes()
    place = data.index(_IDENTITY, data.index(b"tkhd"))
    output.write_bytes(data[:place] + _QUARTER + data[place + len(_QUARTER) :])
    return output
