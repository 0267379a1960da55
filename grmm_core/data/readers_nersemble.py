"""NeRSemble's monocular FLAME avatar benchmark: videos, alpha videos, calibration and FLAME tracking of each sequence.

Layout below the folder (or below ``mono_flame_avatar`` in it)::

    NNN/calibration/camera_params.json                  world_2_cam {serial: 4x4}, intrinsics {serial: 3x3} or 3x3 for all
    NNN/sequences/SEQ/images/cam_SERIAL.mp4             and alpha_maps/cam_SERIAL.mp4
    NNN/sequences/SEQ/tracking/flame2023_tracking.npz   rotation_matrices, translation, shape, expression ...

The full release has no tracking: track its videos with VHAP and give the export instead. Videos are decoded by PyAV (optional).
"""

from __future__ import annotations

import json
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from ..files.access import read_bytes
from ..files.npz import read_npz
from ..pictures.recordings import open_video, pyav
from .foreign import FlameFrame, ForeignDataset, held_out_people, intrinsic_camera, vector3
from .types import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, HELD_OUT_PERSON, TRAIN, Picture, Shot, View

CALIBRATION = Path("calibration") / "camera_params.json"
TRACKING = Path("tracking") / "flame2023_tracking.npz"
BENCHMARK = "mono_flame_avatar"
TEST_SEQUENCES = frozenset({"FREE", "EMO-1-shout+laugh", "SEN-09-frown_events_bad", "SEN-10-port_strong_smokey"})
TEST_CAMERAS = frozenset({"222200046", "220700191", "222200039"})
_ARRAYS = ("shape", "expression", "rotation_matrices", "translation", "jaw", "neck", "eyes", "scale", "frames")
_OPEN_VIDEOS = 8
_SHOTS_PER_SEQUENCE = 100_000


def is_nersemble(folder: Path) -> bool:
    """Whether a folder looks like the data set."""
    return bool(_participants(folder))


class NersembleDataset(ForeignDataset):
    """The benchmark's people opened for training and evaluation; see the module."""

    kind = "NeRSemble data set"

    def refresh(self) -> None:
        """Read people, calibrations and tracking anew. Raises `FileFormatError`, `FileAccessError`."""
        self._videos = _Videos()
        self.manifest.subjects.clear()
        self.shapes.clear()
        self.shots = []
        people = _participants(self.folder)
        self.manifest.held_out_people = held_out_people([path.name for path in people])
        for person in people:
            cameras = _calibration(person / CALIBRATION)
            sequences = sorted(path for path in (person / "sequences").glob("*") if (path / TRACKING).is_file())
            for place, sequence in enumerate(sequences):
                self._add_sequence(person, sequence, place * _SHOTS_PER_SEQUENCE, cameras)
        if not self.shots:
            raise FileFormatError(
                f"{self.folder} has no FLAME tracking ({TRACKING.name}); track it with VHAP and give the folder of its export."
            )

    def _add_sequence(self, person: Path, sequence: Path, first: int, cameras: dict[str, dict[str, np.ndarray]]) -> None:
        path = sequence / TRACKING
        tracks, _ = read_npz(path, _ARRAYS)
        lost = [name for name in _ARRAYS if name not in tracks and name not in ("scale", "frames")]
        if lost:
            raise FileFormatError(f"{path} has no {lost[0]}; download it again.")
        count = len(np.atleast_1d(tracks["expression"]))
        rows = [n for n in ("rotation_matrices", "translation", "jaw", "neck", "eyes", "frames") if n in tracks]
        wrong: list[str] = [n for n in rows if tracks[n].shape[:1] != (count,)]
        if "scale" in tracks and not tracks["scale"].size:
            wrong.append("scale")
        if wrong or tracks["rotation_matrices"].shape != (count, 3, 3) or tracks["eyes"].shape != (count, 6):
            what = wrong[0] if wrong else "rotation_matrices or eyes"
            raise FileFormatError(f"{path}: {what} has a wrong shape; download it again.")
        self.add_person(person.name, tracks["shape"])
        scale = float(tracks["scale"].reshape(-1)[0]) if "scale" in tracks else 1.0
        frames = tracks.get("frames", np.arange(count)).astype(int)
        serials = sorted(path.stem.removeprefix("cam_") for path in (sequence / "images").glob("cam_*.mp4"))
        for serial in serials:
            if serial not in cameras:
                raise FileFormatError(f"{person / CALIBRATION} lacks the camera {serial}; download it again.")
        for row in range(count):
            root = np.eye(4)
            root[:3, :3] = tracks["rotation_matrices"][row] * scale
            root[:3, 3] = vector3(tracks["translation"][row], path, "translation")
            eyes = tracks["eyes"][row]
            frame = FlameFrame(tracks["expression"][row], tracks["neck"][row], tracks["jaw"][row], eyes[:3], eyes[3:], root)
            views = [self._view(person, sequence, serial, int(frames[row]), cameras[serial]) for serial in serials]
            self.shots.append(self.make_shot(person.name, first + row, sequence.name, frame, views, sequence))

    def _view(self, person: Path, sequence: Path, serial: str, frame: int, camera: dict[str, np.ndarray]) -> View:
        split = HELD_OUT_CAMERA if serial in TEST_CAMERAS else TRAIN
        split = HELD_OUT_EXPRESSION if sequence.name in TEST_SEQUENCES else split
        split = HELD_OUT_PERSON if person.name in self.manifest.held_out_people else split
        width, height = self._videos.size(sequence / "images" / f"cam_{serial}.mp4")
        made = intrinsic_camera(camera["pose"], camera["intrinsics"], width, height, person / CALIBRATION, serial)
        return View(serial, made, f"cam_{serial}.mp4:{frame}", "", split)

    def picture(self, shot: Shot, view: View) -> Picture:
        """Decode a view. Raises `FileAccessError`, `FileFormatError`, `RuntimeMissingError`."""
        name, _, frame = view.image.rpartition(":")
        image = self._videos.frame(shot.folder / "images" / name, int(frame))
        mask = self._videos.frame(shot.folder / "alpha_maps" / name, int(frame))
        if image.shape[:2] != mask.shape[:2]:
            raise FileFormatError(f"{shot.folder / 'alpha_maps' / name} has another size than its video; download it again.")
        return Picture(image.astype(np.float32) / 255.0, mask[..., 0].astype(np.float32) / 255.0, None)


class _Videos:
    """Frames of videos by number, with the last few videos kept open."""

    def __init__(self) -> None:
        self._open: OrderedDict[Path, Any] = OrderedDict()
        self._sizes: dict[Path, tuple[int, int]] = {}
        self._lock = threading.Lock()

    def size(self, path: Path) -> tuple[int, int]:
        """Width and height in pixels."""
        if path not in self._sizes:
            with self._lock:
                stream = self._container(path).streams.video[0]
                self._sizes[path] = (int(stream.width), int(stream.height))
        return self._sizes[path]

    def frame(self, path: Path, number: int) -> np.ndarray:
        """RGB, uint8, [H, W, 3]. Raises `FileFormatError` where the video is shorter."""
        av = pyav()
        with self._lock:
            container = self._container(path)
            stream = container.streams.video[0]
            if not stream.average_rate or not stream.time_base:
                raise FileFormatError(f"{path} does not say how many frames a second has; download it again.")
            seconds = number / float(stream.average_rate)
            try:
                container.seek(max(0, round(seconds / float(stream.time_base))), stream=stream)
                for picture in container.decode(stream):
                    if picture.pts is None:
                        raise FileFormatError(f"{path} has frames without a time; download it again.")
                    at = round(float((picture.pts - (stream.start_time or 0)) * stream.time_base * stream.average_rate))
                    if at >= number:
                        pixels: np.ndarray = picture.to_ndarray(format="rgb24")
                        return pixels
            except av.FFmpegError as error:
                raise FileFormatError(f"{path} is a damaged video; download it again.") from error
        raise FileFormatError(f"{path} has no frame {number}; download it again.")

    def _container(self, path: Path) -> Any:
        if path not in self._open:
            self._open[path] = open_video(path, "download it again")
            if len(self._open) > _OPEN_VIDEOS:
                self._open.popitem(last=False)[1].close()
        self._open.move_to_end(path)
        return self._open[path]


def _participants(folder: Path) -> list[Path]:
    base = folder / BENCHMARK if (folder / BENCHMARK).is_dir() else folder
    if (base / CALIBRATION).is_file():
        return [base]
    return sorted(path.parent.parent for path in base.glob(f"*/{CALIBRATION}"))


def _calibration(path: Path) -> dict[str, dict[str, np.ndarray]]:
    try:
        values = json.loads(read_bytes(path, 16 << 20))
        poses, intrinsics = values["world_2_cam"], values["intrinsics"]
        shared = not isinstance(intrinsics, dict)
        return {
            serial: {"pose": np.array(pose, np.float64), "intrinsics": np.array(intrinsics if shared else intrinsics[serial])}
            for serial, pose in poses.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(f"{path} is damaged ({error}); download it again.") from error
