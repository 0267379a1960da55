"""`python -m tools.video_figures [PERFORMANCE]`: how well a performance comes back from a video of an avatar that plays it.

Avatars of the library are filmed while they play a recording, or, unless one is named, a row of single expressions and looks to
both sides; the videos are compressed as phones do, and tracked from the pictures alone. Printed is, by region of the face, how
far landmarks move in truth, how far they are off when the head model moves by what was tracked and by the coefficients that
the landmark network reports, and the correlation of these movements with the truth. `--sheet` takes frames of the first
video above the default avatar that plays what was tracked.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.fitting.landmark_priors import BROWS, EYES, LIPS
from grmm_core.fitting.point_rig import LandmarkRig
from grmm_core.formats import format_to_read
from grmm_core.geometry.camera import Camera
from grmm_core.head.open_head import load_open_head
from grmm_core.performance import Performance
from grmm_core.pictures.images import quantize
from grmm_core.pictures.recordings import pyav
from grmm_core.session import Instance, RenderOptions, create_session
from grmm_core.video.api import track
from grmm_core.video.following import follow
from grmm_core.video.reading import VideoFile
from grmm_core.video.request import TrackRequest

from .people_pictures import PAPER, sheet

ACTORS = ("bun", "curly", "side_part")
FPS, SECONDS, SIZE = 30, 8.0, 480
WALL = (0.4, 0.45, 0.5)
REGIONS = {"lips": LIPS, "eyes": EYES, "brows": BROWS, "whole face": tuple(range(468))}
SHOWN, QUALITY = 8, 85
# Shape (of both sides where there are two), strength, and the seconds at which it is strongest.
_PLAYED: tuple[tuple[tuple[str, ...], float, tuple[float, ...]], ...] = (
    (("jawOpen",), 0.55, (0.8, 3.0, 5.5)), (("mouthSmile",), 0.8, (1.5, 4.2)), (("mouthPucker",), 0.8, (2.2, 6.0)),
    (("mouthFunnel",), 0.8, (2.8,)), (("browDown",), 0.8, (3.5, 6.6)), (("browInnerUp", "browOuterUp"), 0.8, (1.2, 5.0)),
    (("eyeSquint",), 0.8, (4.2,)), (("jawLeft", "mouthLeft"), 0.8, (4.9,)), (("mouthFrown",), 0.8, (6.6,)),
    (("noseSneer", "mouthUpperUp"), 0.8, (7.0,)), (("mouthStretch",), 0.8, (5.5,)), (("mouthLowerDown",), 0.8, (3.0,)),
    (("eyeBlink",), 1.0, (0.5, 1.9, 3.2, 4.6, 6.2, 7.2)),
)  # fmt: skip
_WIDE, _BLINKING = 0.28, 0.07  # seconds


def played() -> Performance:
    """Single expressions one after the other, blinks, and a head that looks around."""
    times = np.arange(round(FPS * SECONDS)) / FPS
    weights = np.zeros((len(times), len(ARKIT_NAMES)), np.float32)
    for shapes, strength, centers in _PLAYED:
        width = _BLINKING if shapes == ("eyeBlink",) else _WIDE
        curve = strength * sum(np.exp(-(((times - center) / width) ** 2)) for center in centers)
        for column in (i for i, name in enumerate(ARKIT_NAMES) if name.startswith(shapes)):
            weights[:, column] += curve
    turn = np.stack([0.12 * np.sin(1.1 * times), 0.4 * np.sin(0.9 * times), 0.1 * np.sin(1.7 * times)], 1)
    return Performance(times, weights.clip(0.0, 1.0), FPS, recorded_shapes=tuple(ARKIT_NAMES), head_rotation=turn)


def filmed(avatar: str, performance: Performance, background: tuple[float, float, float] = WALL) -> list[np.ndarray]:
    """An avatar that plays a performance before a camera, uint8 [SIZE, SIZE, 3] each."""
    camera = Camera.orbit(SIZE, SIZE, distance=1.1, fov=17.0, target=(0.0, 0.0, 0.0))
    options = RenderOptions(background=background)
    with create_session("local") as session:
        number = session.open(avatar).id
        frames = (Instance(number, performance.controls(i, "root")) for i in range(performance.frame_count))
        return [quantize(session.render([instance], camera, options)["rgb"]) for instance in frames]


def write_video(path: Path, frames: Iterable[np.ndarray], fps: float) -> None:
    """Encode pictures as phones do: H.264, a few hundred kilobytes a second."""
    av = pyav()
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=round(fps))
        stream.width = stream.height = SIZE
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "20"}
        for pixels in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())


def movements(rig: LandmarkRig, weights: np.ndarray) -> np.ndarray:
    """Landmarks of the mean head less their mean over the frames, metres, [T, 478, 3]."""
    others, still = np.zeros(rig.expression_count - len(ARKIT_NAMES)), np.zeros((5, 3))
    shape = np.zeros(rig.shape_count)
    points = np.stack([rig.positions(shape, np.concatenate([row, others]), still) for row in weights])
    centered: np.ndarray = points - points.mean(0)
    return centered


def millimetres(moved: np.ndarray) -> float:
    """Root mean square of distances, [T, N, 3] in metres."""
    return 1e3 * float(np.sqrt((moved**2).sum(-1).mean()))


def compare(true: np.ndarray, found: np.ndarray) -> tuple[float, float]:
    """Distance of movements in millimetres, and their correlation."""
    return millimetres(true - found), float(np.corrcoef(true.ravel(), found.ravel())[0, 1])


def measure(actor: str, performance: Performance, folder: Path) -> tuple[list[Any], Path, Performance]:
    """Rows of an actor's table, the video, and what was tracked in it."""
    video, rig = folder / f"{actor}.mp4", LandmarkRig(load_open_head())
    write_video(video, filmed(f"library:{actor}", performance), performance.fps)
    tracked = track(TrackRequest(video, folder / f"{actor}.json")).performance
    with VideoFile(video) as opened:
        reported = follow(opened.frames(), video.name).arkit
    count = min(performance.frame_count, tracked.frame_count)
    true, found, told = (movements(rig, w[:count]) for w in (performance.weights, tracked.weights, reported))
    rows = []
    for region, points in REGIONS.items():
        a, b, c = (moved[:, list(points)] for moved in (true, found, told))
        rows.append((actor, region, millimetres(a), *compare(a, b), *compare(a, c)))
    return rows, video, tracked


def main() -> int:
    """Film, track, print; returns 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("performance", nargs="?", type=Path, help="a recording to play")
    parser.add_argument("--actors", nargs="+", default=list(ACTORS), help="avatars of the library (default: %(default)s)")
    parser.add_argument("--sheet", type=Path, metavar="FILE", help="a picture of frames and of what was tracked in them")
    arguments = parser.parse_args()
    performance = played()
    if arguments.performance is not None:
        performance = format_to_read(arguments.performance, "performance").read(arguments.performance)
    print("| actor | region | moves, mm | tracked: off, mm | correlation | reported: off, mm | correlation |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for number, actor in enumerate(arguments.actors):
            rows, video, tracked = measure(actor, performance, Path(name))
            for row in rows:
                print("| {} | {} | {:.2f} | {:.2f} | {:.3f} | {:.2f} | {:.3f} |".format(*row), flush=True)
            if number == 0 and arguments.sheet is not None:
                picked = np.linspace(0, tracked.frame_count - 1, SHOWN + 2).round().astype(int)[1:-1]
                with VideoFile(video) as opened:
                    shown = [pixels for i, (_, pixels) in enumerate(opened.frames()) if i in picked]
                chosen = Performance(
                    tracked.times[picked], tracked.weights[picked], tracked.fps, recorded_shapes=tracked.recorded_shapes,
                    head_rotation=None if tracked.head_rotation is None else tracked.head_rotation[picked],
                )  # fmt: skip
                played_back = filmed("default", chosen, PAPER)
                tiles = [tile[::2, ::2] for tile in (*shown, *played_back)]
                sheet(tiles, SHOWN).save(arguments.sheet, quality=QUALITY)
    return 0


if __name__ == "__main__":
    sys.exit(main())
