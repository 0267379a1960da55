"""What the readers of other projects' data share: FLAME parameters of a frame become a `Shot` of the common type.

Those data sets come with FLAME parameters, so that the user's FLAME file is needed: it says where the head turns (the root
joint) and which ARKit shapes come closest to an expression. Cameras are moved into head space, as everywhere in the core.

Used by the readers `readers_vhap`, `readers_renderme`, `readers_nersemble`. Needs numpy; Pillow where pictures are touched.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..controls.names import ALIGNED_NAMES, ARKIT_NAMES
from ..errors import ConfigError, FileFormatError
from ..geometry.camera import Camera
from ..geometry.rotations import axis_angle_to_matrix, matrix_to_euler
from ..head import HeadModel
from .dataset import CaptureDataset
from .types import Manifest, Shot, View

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
HELD_OUT_EVERY = 12  # one person of so many is held out where the source does not say
_JAW_WEIGHT = 10.0  # radians of the jaw against expression coefficients of unit variance
_STEPS = 200
_POSE_ROWS = {"neck": 1, "jaw": 2, "left_eye": 3, "right_eye": 4}


@dataclass(frozen=True)
class FlameFrame:
    """FLAME parameters of one moment, as trackers store them.

    Attributes:
        expression: Coefficients, [<=100]; the rest is zero.
        neck, jaw, left_eye, right_eye: Axis-angle vectors, radians, [3].
        head_to_world: Rigid transform of the head, possibly with a uniform scale, [4, 4].
    """

    expression: np.ndarray
    neck: np.ndarray
    jaw: np.ndarray
    left_eye: np.ndarray
    right_eye: np.ndarray
    head_to_world: np.ndarray


class ForeignDataset(CaptureDataset):
    """Base of the readers: the interface of `CaptureDataset` without its files.

    Args:
        folder: Data set.
        head: The user's FLAME; None is refused with what to do.

    Raises:
        ConfigError: No FLAME was given.
        FileAccessError, FileFormatError: The data cannot be read.
    """

    kind = "data set"

    def __init__(self, folder: str | Path, head: HeadModel | None) -> None:
        if head is None or not head.name.startswith("flame"):
            raise ConfigError(f"{folder} is a {self.kind} with FLAME parameters; give your FLAME file with --head FILE.")
        self.folder = Path(folder)
        self.head = head
        self.shapes: dict[str, np.ndarray] = {}
        self.shots: list[Shot] = []
        self.manifest = Manifest(head.name, [], {"reader": self.kind}, [])
        self.refresh()

    def shape(self, subject: str) -> np.ndarray:
        """A person's shape coefficients in the user's FLAME space, [S]. Raises KeyError for somebody else."""
        return self.shapes[subject]

    def facts(self, subject: str) -> dict[str, object]:
        """What the source says of a person: nothing that is used."""
        return {"name": subject}

    def add_person(self, name: str, shape: np.ndarray) -> None:
        """Take a person in, or change one's coefficients: [<= S], filled up with zeros. Raises `FileFormatError`."""
        if name not in self.shapes:
            self.manifest.subjects.append(name)
        self.shapes[name] = padded(shape, self.head.shape_count, self.folder, "shape")

    def make_shot(self, subject: str, number: int, kind: str, frame: FlameFrame, views: Iterable[View], folder: Path) -> Shot:
        """Build a shot from FLAME parameters and views whose cameras are in the world."""
        expression = padded(frame.expression, self.head.expression_count, folder, "expression")
        pose = np.zeros((5, 3))
        for name, row in _POSE_ROWS.items():
            pose[row] = matrix_to_euler(axis_angle_to_matrix(vector3(getattr(frame, name), folder, name)))
        moved = tuple(replace(view, camera=head_camera(view.camera, frame.head_to_world)) for view in views)
        aligned = nearest_arkit(self.head, expression, pose)
        return Shot(subject, number, kind, aligned, expression, pose.astype(np.float32), moved, folder)


def root_transform(head: HeadModel, shape: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """FLAME's global rotation (axis-angle [3], about the root joint of the shaped head) and translation [3] as [4, 4]."""
    joint = head.joints(shape)[0].astype(np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = axis_angle_to_matrix(rotation)
    matrix[:3, 3] = joint - matrix[:3, :3] @ joint + translation
    return matrix


def head_camera(camera: Camera, head_to_world: np.ndarray) -> Camera:
    """The camera in head space, rigid: a scale of the head changes the unit of length, not the picture."""
    matrix = camera.world_to_camera @ head_to_world
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    matrix[:3] /= scale
    return replace(camera, world_to_camera=matrix)


def nearest_arkit(head: HeadModel, expression: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Weights of the aligned expressions that come closest to an expression, [60]; mixtures stay zero.

    Least squares over the 52 ARKit shapes with weights 0..1, by projected gradient. Such data sets have no aligned
    expressions; these weights give the shared codes z_exp something to mean.

    Args:
        head: FLAME with its ARKit map.
        expression: Coefficients, [E].
        pose: Euler angles in radians, [5, 3].
    """
    jaw = _POSE_ROWS["jaw"]
    columns = [head.arkit_to_expression, _JAW_WEIGHT * head.arkit_pose[:, jaw]]
    matrix = np.concatenate(columns, 1).astype(np.float64)  # [52, E + 3]
    target = np.concatenate([expression, _JAW_WEIGHT * pose[jaw]]).astype(np.float64)
    gram = matrix @ matrix.T
    step = 1.0 / max(float(np.linalg.eigvalsh(gram)[-1]), 1e-9)
    wanted = matrix @ target
    weights = np.zeros(len(ARKIT_NAMES))
    for _ in range(_STEPS):
        weights = np.clip(weights + step * (wanted - gram @ weights), 0.0, 1.0)
    aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
    aligned[: len(ARKIT_NAMES)] = weights
    return aligned


def padded(values: np.ndarray, count: int, where: Path, what: str) -> np.ndarray:
    """Coefficients as float32 [count], zeros behind those given.

    Raises:
        FileFormatError: More than `count`, or not finite.
    """
    flat = np.asarray(values, np.float64).reshape(-1)
    if len(flat) > count or not np.isfinite(flat).all():
        raise FileFormatError(
            f"{where} has {len(flat)} {what} coefficients where FLAME has {count}, or some are not finite; track it again."
        )
    result = np.zeros(count, np.float32)
    result[: len(flat)] = flat
    return result


def vector3(values: np.ndarray, where: Path, what: str) -> np.ndarray:
    """Three finite numbers, [3] float64; a rotation matrix is not one. Raises `FileFormatError`."""
    numbers = np.asarray(values)
    flat = numbers.astype(np.float64).reshape(-1) if numbers.dtype.kind in "fiu" else np.zeros(0)
    if flat.shape != (3,) or not np.isfinite(flat).all():
        raise FileFormatError(f"{where}: {what} is not three finite numbers; export or track it again.")
    return flat


def intrinsic_camera(
    world_to_camera: np.ndarray, intrinsics: np.ndarray, width: int, height: int, where: Path, what: str
) -> Camera:
    """A camera of matrices [4, 4] and [3, 3]. Raises `FileFormatError` naming what is wrong."""
    from ..errors import ShapeError

    try:
        k = np.asarray(intrinsics, np.float64)
        if k.shape != (3, 3):
            raise ShapeError("its intrinsics are not 3x3")
        fx, fy, cx, cy = (float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2]))
        return Camera(world_to_camera, fx, fy, cx, cy, int(width), int(height))
    except (ShapeError, ValueError, TypeError) as error:
        raise FileFormatError(f"{where}: camera {what} cannot be used ({str(error).rstrip('.')}); export it again.") from error


def decode(data: bytes, where: str) -> np.ndarray:
    """Decode picture bytes to uint8 [H, W] or [H, W, C]. Raises `FileFormatError`."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data)) as image:
            image.load()
            mode = image.mode if image.mode in ("L", "RGB", "RGBA") else "RGBA" if image.mode in ("LA", "PA") else "RGB"
            return np.asarray(image.convert(mode))
    except (OSError, ValueError, SyntaxError) as error:
        raise FileFormatError(f"{where} is a damaged picture; get it again or remove its frame.") from error


def held_out_people(names: list[str]) -> list[str]:
    """Every twelfth person, in order; nobody where there are fewer."""
    return names[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY]
