"""RenderMe-360: pairs of SMC files (HDF5), ``ID_PART_raw.smc`` with pictures and ``ID_PART_anno.smc`` with all the rest.

Read from the annotation: ``Calibration/CC/{K, D, RT}`` (RT camera to world, OpenCV axes), ``Camera/CC/mask/F``, and
``FLAME/F/{global_pose, neck_pose, jaw_pose, left_eye_pose, right_eye_pose, trans, shape, exp}``; from the raw file
``Camera/CC/color/F``. Pictures are encoded bytes. Only expression parts (``eN``) have FLAME parameters. Lens distortion is
removed on reading. Needs h5py (optional).
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileAccessError, FileFormatError, RuntimeMissingError
from ..geometry.camera import Camera
from ..geometry.rotations import matrix_to_axis_angle
from ..pictures.sampling import bilinear
from .foreign import FlameFrame, ForeignDataset, decode, held_out_people, intrinsic_camera, root_transform, vector3
from .types import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, HELD_OUT_PERSON, TRAIN, Picture, Shot, View

ANNOTATION = re.compile(r"^(?P<actor>[^_]+)_(?P<part>e\d+)_anno\.smc$")
HELD_OUT_CAMERAS = 10  # every tenth camera, from the sixth
PARTS_BEFORE_HOLDING_OUT = 3  # the last part is held out where a person has at least so many
_FRAMES_PER_PART = 100_000
_OPEN_FILES = 8
_FLAME_KEYS = ("global_pose", "neck_pose", "jaw_pose", "left_eye_pose", "right_eye_pose", "trans", "shape", "exp")
_TINY_DISTORTION = 1e-9
_MAX_ARRAY_BYTES = 256 << 20  # of one picture, or a set of parameters


def is_renderme(folder: Path) -> bool:
    """Whether a folder looks like the data set."""
    return next(_annotations(folder), None) is not None


class RenderMeDataset(ForeignDataset):
    """The data set's expression parts opened for training and evaluation; see the module."""

    kind = "RenderMe-360 data set"

    def refresh(self) -> None:
        """Read people, calibrations and FLAME parameters anew. Raises `FileFormatError`, `FileAccessError`."""
        self._files = _Files()
        self._distortion: dict[tuple[Path, str], np.ndarray] = {}
        self.manifest.subjects.clear()
        self.shapes.clear()
        self.shots = []
        parts: dict[str, list[tuple[int, Path]]] = {}
        for path in _annotations(self.folder):
            match = ANNOTATION.match(path.name)
            if match:
                parts.setdefault(match["actor"], []).append((int(match["part"][1:]), path))
        self.manifest.held_out_people = held_out_people(sorted(parts))
        for actor in sorted(parts):
            ordered = sorted(parts[actor])
            for place, (part, path) in enumerate(ordered):
                last = place == len(ordered) - 1 and len(ordered) >= PARTS_BEFORE_HOLDING_OUT
                split = HELD_OUT_PERSON if actor in self.manifest.held_out_people else HELD_OUT_EXPRESSION if last else ""
                with _damage(path):
                    self._add_part(actor, part, path, split)
        if not self.shots:
            raise FileFormatError(f"{self.folder} has no frames with FLAME parameters; download parts e0 to e11.")

    def _add_part(self, actor: str, part: int, path: Path, split: str) -> None:
        raw = raw_file(path)
        if raw is None:
            name = path.name.replace("_anno", "_raw")
            raise FileAccessError(f"{path} has no file {name} beside it or under raw; download it.")
        annotation, pictures = self._files.get(path), self._files.get(raw)
        cameras = self._cameras(path, annotation, pictures)
        group = _group(annotation, "FLAME", path)
        for frame in sorted((name for name in group if name.isdigit()), key=int):
            values = {key: _array(group, f"{frame}/{key}", path) for key in _FLAME_KEYS}
            if actor not in self.shapes:
                self.add_person(actor, values["shape"])
            root = root_transform(
                self.head, self.shapes[actor], _turn(values["global_pose"]), vector3(values["trans"], path, "trans")
            )
            neck, jaw, left, right = (_turn(values[f"{name}_pose"]) for name in ("neck", "jaw", "left_eye", "right_eye"))
            views = [
                View(name, camera, f"{name}/{frame}", "", split or _camera_split(number))
                for number, (name, camera) in enumerate(cameras.items())
                if f"{name}/color/{frame}" in pictures["Camera"] and f"{name}/mask/{frame}" in annotation["Camera"]
            ]
            flame = FlameFrame(values["exp"], neck, jaw, left, right, root)
            number = part * _FRAMES_PER_PART + int(frame)
            self.shots.append(self.make_shot(actor, number, f"e{part}", flame, views, path))

    def _cameras(self, path: Path, annotation: Any, pictures: Any) -> dict[str, Camera]:
        calibration = _group(annotation, "Calibration", path)
        resolution = np.asarray(_group(pictures, "Camera", path).attrs.get("resolution", ())).reshape(-1)
        if resolution.shape != (2,):
            raise FileFormatError(f"{path}: the pictures' resolution is missing; download the raw file again.")
        height, width = (int(v) for v in resolution)
        cameras = {}
        for name in sorted(calibration):
            matrices = {key: _array(calibration, f"{name}/{key}", path) for key in ("K", "D", "RT")}
            to_world = np.eye(4)
            if matrices["RT"].shape not in ((3, 4), (4, 4)):
                raise FileFormatError(f"{path}: camera {name} has no usable RT; download it again.")
            to_world[:3] = matrices["RT"][:3]
            try:
                to_camera = np.linalg.inv(to_world)
            except np.linalg.LinAlgError as error:
                raise FileFormatError(f"{path}: camera {name} has no usable RT; download it again.") from error
            cameras[name] = intrinsic_camera(to_camera, matrices["K"], width, height, path, name)
            self._distortion[path, name] = matrices["D"].astype(np.float64).reshape(-1)
        return cameras

    def picture(self, shot: Shot, view: View) -> Picture:
        """Decode a view and remove the lens distortion. Raises `FileAccessError`, `FileFormatError`."""
        name, _, frame = view.image.partition("/")
        path = shot.folder
        pixels = []
        for file, kind in ((raw_file(path) or path, "color"), (path, "mask")):
            with _damage(file):
                data = _array(_group(self._files.get(file), "Camera", file), f"{name}/{kind}/{frame}", file)
            pixels.append(decode(np.ascontiguousarray(data).tobytes(), f"{file}: {name}/{kind}/{frame}"))
        image = pixels[0][..., :3] if pixels[0].ndim == 3 else np.repeat(pixels[0][..., None], 3, 2)
        mask = pixels[1] if pixels[1].ndim == 2 else pixels[1].max(-1)
        size = (view.camera.height, view.camera.width)
        if image.shape[:2] != size or mask.shape != size:
            raise FileFormatError(f"{path}: picture {view.image} is not {size[1]}x{size[0]} as its camera; download it again.")
        both = np.concatenate([image, mask[..., None]], 2).astype(np.float32) / 255.0
        both = undistorted(both, view.camera, self._distortion[path, name])
        return Picture(both[..., :3], both[..., 3], None)


def undistorted(image: np.ndarray, camera: Camera, coefficients: np.ndarray) -> np.ndarray:
    """Remove lens distortion, keeping the intrinsics.

    Args:
        image: [H, W, C] float32.
        camera: Of the result.
        coefficients: k1, k2, p1, p2 and optionally k3 of the usual model of radial and tangential distortion.
    """
    k1, k2, p1, p2, k3 = (float(v) for v in np.concatenate([coefficients[:5], np.zeros(5)])[:5])
    if max(abs(v) for v in (k1, k2, p1, p2, k3)) < _TINY_DISTORTION:
        return image
    height, width = image.shape[:2]
    rows, columns = np.mgrid[:height, :width]
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    r = x * x + y * y
    radial = 1.0 + r * (k1 + r * (k2 + r * k3))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r + 2.0 * x * x)
    v = y * radial + p1 * (r + 2.0 * y * y) + 2.0 * p2 * x * y
    return bilinear(image, np.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], -1))


def raw_file(annotation: Path) -> Path | None:
    """The raw file of an annotation: beside it, or under ``raw`` where the annotation is under ``anno``."""
    name = annotation.name.replace("_anno.smc", "_raw.smc")
    places = [annotation.parent / name, annotation.parent.parent.parent / "raw" / annotation.parent.name / name]
    return next((place for place in places if place.is_file()), None)


class _Files:
    """HDF5 files, the last few kept open."""

    def __init__(self) -> None:
        self._open: OrderedDict[Path, Any] = OrderedDict()

    def get(self, path: Path) -> Any:
        if path not in self._open:
            h5py = _h5py()
            try:
                self._open[path] = h5py.File(path, "r")
            except FileNotFoundError as error:
                raise FileAccessError(f"{path} does not exist; download it.") from error
            except OSError as error:
                raise FileFormatError(f"{path} is not a complete SMC file; download it again.") from error
            if len(self._open) > _OPEN_FILES:
                self._open.popitem(last=False)[1].close()
        self._open.move_to_end(path)
        return self._open[path]


def _h5py() -> Any:
    try:
        import h5py
    except ImportError as error:
        raise RuntimeMissingError("SMC files of RenderMe-360 are HDF5; run pip install h5py.") from error
    return h5py


def _annotations(folder: Path) -> Any:
    return (path for path in folder.rglob("*_anno.smc") if ANNOTATION.match(path.name))


def _camera_split(number: int) -> str:
    return HELD_OUT_CAMERA if number % HELD_OUT_CAMERAS == HELD_OUT_CAMERAS // 2 else TRAIN


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Turn what h5py raises into a sentence: HDF5 notices damage at whatever node is walked to, with errors of all kinds."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, TypeError, ValueError, AttributeError, OverflowError, MemoryError) as error:
        raise FileFormatError(f"{path} is damaged ({type(error).__name__}); download it again.") from error


def _group(file: Any, name: str, path: Path) -> Any:
    if name not in file:
        raise FileFormatError(f"{path} has no {name}; download it again.")
    return file[name]


def _array(group: Any, name: str, path: Path) -> np.ndarray:
    if name not in group:
        raise FileFormatError(f"{path} has no {group.name.strip('/')}/{name}; download it again.")
    data = group[name]
    if data.size * data.dtype.itemsize > _MAX_ARRAY_BYTES:  # before h5py makes room for what a header claims
        raise FileFormatError(f"{path}: {name} claims {data.size} numbers; download it again.")
    return np.asarray(data[()])


def _turn(values: np.ndarray) -> np.ndarray:
    """An axis-angle vector [3] from a vector or a rotation matrix."""
    flat = np.asarray(values, np.float64).reshape(-1)
    return matrix_to_axis_angle(flat.reshape(3, 3)) if flat.size == 9 else flat
