"""From a video to a performance, in one call. Needs torch and PyAV."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..avatar import load_avatar
from ..controls.names import ARKIT_NAMES
from ..errors import FileAccessError, NoFaceError
from ..fitting.point_rig import LandmarkRig
from ..formats.performances.arkit_json import write_arkit_json
from ..geometry.rotations import matrix_to_euler, unwrap_euler
from ..head.open_head import load_open_head
from ..jobs.progress import Reporter
from ..jobs.stages import TRACK
from ..performance import Performance, resample
from .actor import find_actor
from .finishing import fill_gaps, gap_warning, steady_gaze, whole_blinks
from .following import follow
from .reading import VideoFile
from .request import TrackRequest
from .solving import solve_frames

SOURCE = "video"
_UNCERTAIN = 0.06  # of the outer eye corners' distance between landmarks and head, in the median: no such face
_UNEVEN = 0.2  # of a frame's length, by which frames may come early or late


@dataclass(frozen=True)
class Tracked:
    """A performance capture's result.

    Attributes:
        performance: At a constant rate; its `warnings` say what was made up.
        path: The file.
        error: Distance of landmarks from the head's, median over frames in distances of the outer eye corners.
    """

    performance: Performance
    path: Path
    error: float


def track(
    request: TrackRequest,
    progress: Callable[..., None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Tracked:
    """Capture the performance in a video, and write it whole or not at all.

    Args:
        request: What is asked.
        progress: Called with `jobs.progress.Progress`.
        cancelled: Asked often; True ends the work.

    Raises:
        CancelledError: `cancelled` said so.
        FileAccessError, FileFormatError: The video or the avatar cannot be read, or the file not be written.
        NoFaceError: The video shows no face that can be followed.
        RuntimeMissingError: PyAV is not installed.
    """
    reporter = Reporter(TRACK, progress, cancelled)
    reporter("load", 0.0)
    if not request.output.parent.is_dir():
        raise FileAccessError(f"The folder {request.output.parent} does not exist; make it or choose another one.")
    head = load_open_head()
    rig = LandmarkRig(head)
    warnings: list[str] = []
    shape = None
    if request.person is not None:
        avatar = load_avatar(request.person)
        if avatar.head.name == head.name:
            shape = avatar.shape.astype(np.float64)
        else:
            warnings.append(f"{request.person.name} has another head model; the person's shape was found in the video.")
    with VideoFile(request.recording) as video:
        fps, name = video.fps, request.recording.name
        length = None if video.duration is None else min(video.duration, request.end or np.inf) - request.start
        if length is not None and length <= 0.0:
            raise FileAccessError(f"{name} is {video.duration:.1f} s long; begin before second {request.start:g}.")
        followed = follow(
            video.frames(request.start, request.end), name, face=request.face,
            expected=None if length is None else round(length * fps), progress=reporter.part("read"),
        )  # fmt: skip
    actor = find_actor(followed, rig, shape, reporter.part("person"))
    motion = solve_frames(followed, actor, rig, reporter.part("solve"))
    error = float(np.nanmedian(motion.error))
    if error > _UNCERTAIN:
        raise NoFaceError(
            f"The face in {name} cannot be followed: it is turned away, covered or not a person's; use another video."
        )
    times, seen = followed.times - followed.times[0], followed.seen
    weights = fill_gaps(motion.weights, seen, times)
    weights = steady_gaze(whole_blinks(weights, times), times)
    turned = np.zeros((len(times), 3))
    turned[seen] = unwrap_euler(matrix_to_euler(motion.rotation[seen]))
    turned = fill_gaps(turned, seen, times)
    warnings += [sentence for sentence in (gap_warning(seen, times),) if sentence]
    performance = Performance(
        times, weights, fps, SOURCE, tuple(ARKIT_NAMES), head_rotation=turned.astype(np.float32), warnings=warnings
    )
    if len(times) > 1 and np.abs(np.diff(times) * fps - 1.0).max() > _UNEVEN:  # phones drop frames, and slow down in the dark
        performance = resample(performance, fps)
    reporter.check()
    write_arkit_json(request.output, performance)
    reporter("solve", 1.0)
    return Tracked(performance, request.output, error)
