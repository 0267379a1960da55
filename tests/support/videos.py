"""Videos and sound files that tests make, encoded on the spot, and what phones write into their headers."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

_IDENTITY = b"".join(value.to_bytes(4, "big") for value in (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30))
_QUARTER = b"".join(value.to_bytes(4, "big") for value in (0, 1 << 16, 0, (1 << 32) - (1 << 16), 0, 0, 0, 0, 1 << 30))


_RATE, _BLOCK = 48_000, 1024  # samples a second, and in a frame of sound


def write_video(
    path: Path, frames: Iterable[np.ndarray], fps: int = 15, times: Iterable[float] | None = None, sound: float = 0.0
) -> Path:
    """Encode frames [H, W, 3] uint8, shown at `times` in seconds or one after the other, with so many seconds of a tone."""
    import av

    ticks = None if times is None else [round(time * 1000) for time in times]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "16", "preset": "veryfast"}
        heard = container.add_stream("aac", rate=_RATE, layout="mono") if sound else None  # before anything is written
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
        if heard is not None:
            for begin in range(0, round(sound * _RATE), _BLOCK):
                tone = np.sin(np.arange(begin, begin + _BLOCK) * (440.0 * 2.0 * np.pi / _RATE)).astype(np.float32)
                block = av.AudioFrame.from_ndarray(0.1 * tone[None], format="fltp", layout="mono")
                block.sample_rate, block.pts, block.time_base = _RATE, begin, Fraction(1, _RATE)
                container.mux(heard.encode(block))
            container.mux(heard.encode())
    return path


def write_sound(path: Path, samples: np.ndarray, rate: int, written_rate: int, channels: int) -> Path:
    """Encode samples [N] int16 as a file of 16 bits, in another rate and the same in each channel."""
    import av

    layout = {1: "mono", 2: "stereo"}[channels]
    frame = av.AudioFrame.from_ndarray(samples[None], format="s16", layout="mono")
    frame.sample_rate = rate
    resampler = av.AudioResampler(format="s16", layout=layout, rate=written_rate)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=written_rate, layout=layout)
        for block in [*resampler.resample(frame), *resampler.resample(None)]:
            container.mux(stream.encode(block))
        container.mux(stream.encode(None))
    return path


def filmed(
    avatar: str, weights: np.ndarray, turn: np.ndarray, size: int = 256
) -> list[np.ndarray]:  # fmt: skip
    """Frames [size, size, 3] uint8 of an avatar with these ARKit weights [T, 52], turned to a side by radians [T], bald."""
    from grmm_core.controls.frame import Controls
    from grmm_core.geometry.camera import Camera
    from grmm_core.pictures.images import quantize
    from grmm_core.session import HairUse, Instance, RenderOptions, create_session
    from grmm_core.session.wearing import NO_HAIR

    camera = Camera.orbit(size, size, yaw=0.0, pitch=0.0, distance=1.1, fov=17.0, target=(0.0, 0.0, 0.0))
    options, frames = RenderOptions(background=(0.4, 0.45, 0.5)), []
    with create_session("local", threads=1) as session:
        number = session.open(avatar).id
        for row, angle in zip(weights, turn, strict=True):
            controls = Controls()
            controls.aligned[: len(row)] = row
            controls.pose[0, 1] = angle
            instance = Instance(number, controls, hair=HairUse(NO_HAIR))
            frames.append(quantize(session.render([instance], camera, options)["rgb"]))
    return frames


def turned_by_a_quarter(path: Path, output: Path) -> Path:
    """A copy whose header says that the phone was held upright: players turn its pictures clockwise."""
    data = path.read_bytes()
    place = data.index(_IDENTITY, data.index(b"tkhd"))
    output.write_bytes(data[:place] + _QUARTER + data[place + len(_QUARTER) :])
    return output
