"""Folders that VHAP exports (also as GaussianAvatars uses them): ``transforms*.json``, images, masks, FLAME parameters.

``transforms_train.json`` is the training split, ``_val`` holds other cameras of the same moments, ``_test`` other moments;
where only ``transforms.json`` is there, all of it is for training. A folder is one person. Offsets of single vertices
(``static_offset``, ``dynamic_offset``) are left out: the learned displacement takes their place.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileAccessError, FileFormatError
from ..files.access import read_bytes
from ..files.npz import read_npz
from ..geometry.camera import Camera
from .foreign import OPENGL_TO_OPENCV, FlameFrame, ForeignDataset, decode, intrinsic_camera, root_transform, vector3
from .types import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, TRAIN, Picture, Shot, View

ALL = "transforms.json"
FILES = {"transforms_train.json": TRAIN, "transforms_val.json": HELD_OUT_CAMERA, "transforms_test.json": HELD_OUT_EXPRESSION}
MAX_JSON_BYTES = 1 << 30
_REQUIRED = ("timestep_index", "transform_matrix", "file_path", "flame_param_path")
_PARAMETERS = ("translation", "rotation", "neck_pose", "jaw_pose", "eyes_pose", "shape", "expr")
_SEPARATOR = "\n"  # between the names of a view's picture and mask


def is_vhap(folder: Path) -> bool:
    """Whether a folder looks like an export."""
    return any((folder / name).is_file() for name in (ALL, *FILES))


class VhapDataset(ForeignDataset):
    """An export opened for training and evaluation; see the module."""

    kind = "VHAP export"

    def refresh(self) -> None:
        """Read the lists of frames of all splits anew. Raises `FileFormatError`, `FileAccessError`."""
        present = {name: split for name, split in FILES.items() if (self.folder / name).is_file()}
        frames: dict[int, list[tuple[dict[str, Any], str]]] = {}
        for name, split in (present or {ALL: TRAIN}).items():
            for number, frame in enumerate(_frames(self.folder / name)):
                missing = [key for key in _REQUIRED if key not in frame]
                if missing:
                    raise FileFormatError(
                        f"{self.folder / name}: frame {number} has no {missing[0]}; export again with FLAME parameters."
                    )
                frames.setdefault(_whole(frame["timestep_index"], self.folder / name, number), []).append((frame, split))
        if not frames:
            raise FileFormatError(f"{self.folder} lists no frames; export it again.")
        self.manifest.subjects.clear()
        self.shapes.clear()
        self.shots = [self._shot(number, frames[number]) for number in sorted(frames)]

    def _shot(self, number: int, frames: list[tuple[dict[str, Any], str]]) -> Shot:
        path = self.folder / str(frames[0][0]["flame_param_path"])
        arrays, _ = read_npz(path, _PARAMETERS)
        lost = [name for name in _PARAMETERS if name not in arrays]
        if lost:
            raise FileFormatError(f"{path} has no {lost[0]}; export again with FLAME parameters.")
        name = self.folder.name
        self.add_person(name, arrays["shape"])
        eyes = arrays["eyes_pose"].reshape(-1)
        if eyes.shape != (6,):
            raise FileFormatError(f"{path}: eyes_pose is not six numbers; export it again.")
        root = root_transform(
            self.head, self.shapes[name], vector3(arrays["rotation"], path, "rotation"),
            vector3(arrays["translation"], path, "translation"),
        )  # fmt: skip
        frame = FlameFrame(arrays["expr"], arrays["neck_pose"], arrays["jaw_pose"], eyes[:3], eyes[3:], root)
        views = [self._view(values, split) for values, split in frames]
        return self.make_shot(name, number, "tracked", frame, views, self.folder)

    def _view(self, frame: dict[str, Any], split: str) -> View:
        where = self.folder / str(frame["file_path"])
        name = str(frame.get("camera_id", frame.get("camera_index", "")))
        try:
            matrix = np.array(frame["transform_matrix"], np.float64)
            to_camera = OPENGL_TO_OPENCV @ np.linalg.inv(matrix)
            width, height = int(frame["w"]), int(frame["h"])
            k = np.eye(3)
            k[0, 0], k[1, 1], k[0, 2], k[1, 2] = (float(frame[key]) for key in ("fl_x", "fl_y", "cx", "cy"))
        except (KeyError, ValueError, TypeError, OverflowError, np.linalg.LinAlgError) as error:
            raise FileFormatError(f"{where}: its camera is missing or damaged ({error}); export it again.") from error
        camera = intrinsic_camera(to_camera, k, width, height, where, name)
        key = _SEPARATOR.join([str(frame["file_path"]), str(frame.get("fg_mask_path") or "")])
        return View(name, camera, key, "", split)

    def picture(self, shot: Shot, view: View) -> Picture:
        """Decode a view. Raises `FileAccessError`, `FileFormatError`."""
        image_name, _, mask_name = view.image.partition(_SEPARATOR)
        image = _decoded(self.folder / image_name, view.camera)
        if mask_name:
            mask = _decoded(self.folder / mask_name, view.camera)
            mask = mask if mask.ndim == 2 else mask[..., 0]
        elif image.ndim == 3 and image.shape[2] == 4:
            mask = image[..., 3]
        else:
            raise FileFormatError(f"{self.folder / image_name} has no mask; export again with foreground masks.")
        image = image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)
        return Picture(image[..., :3].astype(np.float32) / 255.0, mask.astype(np.float32) / 255.0, None)


def _whole(value: Any, path: Path, number: int) -> int:
    if isinstance(value, (int, float)) and value == value // 1:  # neither infinite nor NaN
        return int(value)
    raise FileFormatError(f"{path}: the timestep_index of frame {number} is not a whole number; export it again.")


def _decoded(path: Path, camera: Camera) -> np.ndarray:
    pixels = decode(read_bytes(path), str(path))
    if pixels.shape[:2] != (camera.height, camera.width):
        raise FileFormatError(f"{path} has another size than its camera ({camera.width}x{camera.height}); export it again.")
    return pixels


def _frames(path: Path) -> list[dict[str, Any]]:
    try:
        values = json.loads(read_bytes(path, MAX_JSON_BYTES))
        frames = values["frames"]
    except (ValueError, KeyError, TypeError) as error:
        raise FileFormatError(f"{path} is damaged or has no frames; export it again.") from error
    except FileAccessError:
        raise
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise FileFormatError(f"{path} is damaged or has no frames; export it again.")
    return frames
