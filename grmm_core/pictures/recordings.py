"""Recordings (videos and sound files) opened by PyAV (FFmpeg), which is imported when it is needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import FileAccessError, FileFormatError, RuntimeMissingError

_AS_VOICE = "a voice is imported as GRMM Performance from Voice, or by grmm speak"


def pyav() -> Any:
    """The library. Raises `RuntimeMissingError` where it is not installed."""
    try:
        import av
    except ImportError as error:
        raise RuntimeMissingError(
            "Reading recordings needs PyAV; run pip install av, or install Blender's runtime again."
        ) from error
    return av


def open_video(path: Path, remedy: str) -> Any:
    """Open a file that has pictures.

    Args:
        path: The file.
        remedy: What to do about a file that cannot be read, for messages: "choose another video".

    Returns:
        PyAV's container.

    Raises:
        FileAccessError: It is missing, a folder, or may not be read.
        FileFormatError: It is no video, or one without pictures.
        RuntimeMissingError: PyAV is not installed.
    """
    container = _open(path, "video", remedy)
    streams = container.streams.video
    if not streams or streams[0].codec_context is None or not streams[0].width:  # none for a codec that a header misnames
        heard = not streams and container.streams.audio
        container.close()
        if heard:
            raise FileFormatError(f"{path} has sound but no pictures; {_AS_VOICE}.")
        raise FileFormatError(f"{path} has no pictures; {remedy}.")
    return container


def open_sound(path: Path, remedy: str) -> Any:
    """Open a file that has sound: a sound file or a video. Arguments, result and errors are those of `open_video`."""
    container = _open(path, "recording", remedy)
    streams = container.streams.audio
    if not streams or streams[0].codec_context is None or not streams[0].rate:
        container.close()
        raise FileFormatError(f"{path} has no sound; {remedy}.")
    return container


def _open(path: Path, kind: str, remedy: str) -> Any:
    av = pyav()
    if path.is_dir():
        raise FileAccessError(f"{path} is a folder; choose a {kind}'s file.")
    try:
        return av.open(str(path), metadata_errors="replace")
    except FileNotFoundError as error:
        raise FileAccessError(f"{path} does not exist; choose another file.") from error
    except PermissionError as error:
        raise FileAccessError(f"{path} may not be read; change its permissions.") from error
    except (av.FFmpegError, OSError, ValueError) as error:
        raise FileFormatError(f"{path} is not a readable {kind}; {remedy}.") from error
