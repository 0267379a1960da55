"""The capture data set: pictures, masks, depth and exact parameters of people performing aligned expressions.

Written by the capture studio, read by training, evaluation and fitting; other readers turn foreign data into the same types.
Needs numpy; Pillow where pictures are touched. May not import torch or bpy.

Folder::

    dataset.json                 format, version, settings, people, splits
    subjects/NAME.json           what is known of a person; NAME.npy: shape coefficients
    shots/NAME/0003.json         one shot's record; written last, so what has a record is complete
    shots/NAME/0003.npz          aligned [60], expression [E], pose [5, 3]
    shots/NAME/0003_00.png       RGBA, straight color in display sRGB, alpha is the mask
    shots/NAME/0003_00_z.png     16-bit depth along the optical axis in 0.1 mm; 0 is background
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..controls.names import ALIGNED_NAMES
from ..errors import FileAccessError, FileFormatError, ShapeError
from ..files.access import atomic_write_bytes, make_folder, read_bytes
from ..files.npz import read_npz
from ..geometry.camera import Camera

FORMAT = "grmm-capture"
VERSION = 1
DEPTH_UNIT = 1e-4  # metres
POSE_SHAPE = (5, 3)
MAX_SHAPE_BYTES = 1 << 20
TRAIN, HELD_OUT_PERSON, HELD_OUT_EXPRESSION, HELD_OUT_CAMERA = "train", "person", "expression", "camera"
SPLITS = (TRAIN, HELD_OUT_PERSON, HELD_OUT_EXPRESSION, HELD_OUT_CAMERA)


@dataclass(frozen=True)
class View:
    """One picture of a shot.

    Attributes:
        name: Camera name.
        camera: Camera in head space.
        image, depth: File names in the shot's folder; depth may be empty.
        split: One of `SPLITS`.
    """

    name: str
    camera: Camera
    image: str
    depth: str
    split: str


@dataclass(frozen=True)
class Shot:
    """One expression of one person.

    Attributes:
        subject: Person's name.
        number: Number of the shot.
        kind: "neutral", "single", "mix" or what the source calls it.
        aligned: Weights of the 60 aligned expressions, [60].
        expression: Head-model coefficients, [E].
        pose: XYZ Euler angles of the five joints including those of the expression, radians, [5, 3].
        views: Pictures.
        folder: Where the pictures are.
    """

    subject: str
    number: int
    kind: str
    aligned: np.ndarray
    expression: np.ndarray
    pose: np.ndarray
    views: tuple[View, ...]
    folder: Path


@dataclass(frozen=True)
class Picture:
    """A decoded view.

    Attributes:
        rgb: Straight display sRGB 0..1, float32, [H, W, 3].
        mask: Coverage 0..1, float32, [H, W].
        depth: Metres along the optical axis, 0 where nothing is, float32, [H, W]; None where the source has none.
    """

    rgb: np.ndarray
    mask: np.ndarray
    depth: np.ndarray | None

    def over(self, background: float | np.ndarray) -> np.ndarray:
        """Color over a constant background 0..1, [H, W, 3]."""
        alpha = self.mask[..., None]
        return (self.rgb * alpha + np.asarray(background, np.float32) * (1 - alpha)).astype(np.float32)


@dataclass
class Manifest:
    """What `dataset.json` says.

    Attributes:
        head: Name of the head model.
        subjects: People's names, in order.
        settings: How it was made; the studio's own keys.
        held_out_people: Names.
    """

    head: str
    subjects: list[str]
    settings: dict[str, Any] = field(default_factory=dict)
    held_out_people: list[str] = field(default_factory=list)


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write `dataset.json`. Raises `FileAccessError`."""
    make_folder(folder)
    values = {"format": FORMAT, "version": VERSION, **manifest.__dict__}
    atomic_write_bytes(folder / "dataset.json", json.dumps(values, indent=1).encode())


def read_manifest(folder: str | Path) -> Manifest:
    """Read `dataset.json`.

    Raises:
        FileAccessError: There is none.
        FileFormatError: Another format or version, or damaged.
    """
    path = Path(folder) / "dataset.json"
    values = _json(path)
    if values.get("format") != FORMAT:
        raise FileFormatError(f"{folder} is not a capture data set; choose a folder that grmm capture made.")
    if values.get("version") != VERSION:
        raise FileFormatError(
            f"{folder} is a capture of version {values.get('version')}, this program reads {VERSION}; update it."
        )
    try:
        people = [list(map(str, values[key])) for key in ("subjects", "held_out_people")]
        if len(set(people[0])) < len(people[0]):
            raise ValueError("a person is listed twice")
        return Manifest(values["head"], people[0], dict(values["settings"]), people[1])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"{path} is damaged ({error}); capture again into an empty folder.") from error


def write_subject(folder: Path, name: str, shape: np.ndarray, facts: dict[str, Any]) -> None:
    """Write a person's shape coefficients [S] and facts. Raises `FileAccessError`."""
    target = folder / "subjects"
    make_folder(target)
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(shape, np.float32))
    atomic_write_bytes(target / f"{name}.npy", buffer.getvalue())
    atomic_write_bytes(target / f"{name}.json", json.dumps(facts, indent=1).encode())


def shot_record(folder: Path, subject: str, number: int) -> Path:
    """Path of a shot's record; it exists when the shot is complete."""
    return folder / "shots" / subject / f"{number:04d}.json"


def write_shot(folder: Path, shot: Shot, pictures: list[Picture]) -> None:
    """Write pictures and arrays, then the record.

    Raises:
        FileAccessError: The folder is not writable or the disk is full; there is then no record.
    """
    if len(pictures) != len(shot.views):
        raise ShapeError(f"{len(pictures)} pictures were given for {len(shot.views)} views; give one each.")
    record = shot_record(folder, shot.subject, shot.number)
    make_folder(record.parent)
    for view, picture in zip(shot.views, pictures, strict=True):
        atomic_write_bytes(record.parent / view.image, encode_rgba(picture.rgb, picture.mask))
        if view.depth and picture.depth is not None:
            atomic_write_bytes(record.parent / view.depth, encode_depth(picture.depth))
    buffer = io.BytesIO()
    np.savez(
        buffer,
        aligned=shot.aligned.astype(np.float32),
        expression=shot.expression.astype(np.float32),
        pose=shot.pose.astype(np.float32),
    )
    atomic_write_bytes(record.with_suffix(".npz"), buffer.getvalue())
    values = {
        "subject": shot.subject,
        "number": shot.number,
        "kind": shot.kind,
        "views": [
            {"name": v.name, "image": v.image, "depth": v.depth, "split": v.split, "camera": camera_to_json(v.camera)}
            for v in shot.views
        ],
    }
    atomic_write_bytes(record, json.dumps(values).encode())


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """Plain values of a camera."""
    names = ("fx", "fy", "cx", "cy", "width", "height", "orthographic")
    return {"world_to_camera": camera.world_to_camera.tolist(), **{name: getattr(camera, name) for name in names}}


def camera_from_json(values: dict[str, Any]) -> Camera:
    """The opposite of `camera_to_json`. Raises `ShapeError`, KeyError or TypeError for bad values."""
    return Camera(**{**values, "world_to_camera": np.array(values["world_to_camera"], np.float64)})


class CaptureDataset:
    """A capture folder opened for reading.

    Only complete shots are seen. Records are read once; pictures are decoded on demand.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.manifest = read_manifest(self.folder)
        self.shots: list[Shot] = []
        self.refresh()

    def refresh(self) -> None:
        """Read records again; a running capture adds some. Raises `FileFormatError` naming a record that cannot be used."""
        shots = []
        for name in self.manifest.subjects:
            for path in sorted((self.folder / "shots" / name).glob("????.json")):
                shots.append(_read_shot(path))
                count, usual = len(shots[-1].expression), len(shots[0].expression)
                if count != usual:
                    raise FileFormatError(
                        f"{path} has {count} expression coefficients and the first shot {usual}; delete it and run the capture "
                        "again."
                    )
        self.shots = shots

    @property
    def subjects(self) -> list[str]:
        """People with at least one complete shot, in the manifest's order."""
        present = {shot.subject for shot in self.shots}
        return [name for name in self.manifest.subjects if name in present]

    def shape(self, subject: str) -> np.ndarray:
        """Shape coefficients of a person, float32 [S]. Raises `FileAccessError`, `FileFormatError`."""
        path = self.folder / "subjects" / f"{subject}.npy"
        try:
            values = np.load(io.BytesIO(read_bytes(path, limit=MAX_SHAPE_BYTES)), allow_pickle=False)
        except (ValueError, TypeError, SyntaxError, EOFError, MemoryError, OSError, TokenError, BadZipFile) as error:
            # what numpy raises for damaged headers, and for headers that claim more than there is
            raise FileFormatError(f"{path} is damaged ({_reason(error)}); delete it and capture the person again.") from error
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
            raise FileFormatError(f"{path} holds no numbers; delete it and capture the person again.")
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
            raise FileFormatError(
                f"{path} is not a row of finite numbers (its size is {_size(values)}); delete it and capture the person again."
            )
        return values.astype(np.float32)

    def facts(self, subject: str) -> dict[str, Any]:
        """What the source knows of a person."""
        return _json(self.folder / "subjects" / f"{subject}.json")

    def views(self, *splits: str) -> Iterator[tuple[Shot, View]]:
        """Views of the named splits (all where none is named)."""
        for shot in self.shots:
            for view in shot.views:
                if not splits or view.split in splits:
                    yield shot, view

    def picture(self, shot: Shot, view: View) -> Picture:
        """Decode a view.

        Raises:
            FileAccessError: A file is missing.
            FileFormatError: A picture is damaged or of another size than its camera.
        """
        path = shot.folder / view.image
        rgba = _decode(path)
        if rgba.shape != (view.camera.height, view.camera.width, 4) or rgba.dtype != np.uint8:
            raise FileFormatError(
                f"{path} is not the RGBA picture that its record describes; delete the shot's record and capture again."
            )
        depth = None
        if view.depth:
            z = _decode(shot.folder / view.depth)
            if z.shape != rgba.shape[:2]:
                raise FileFormatError(
                    f"{shot.folder / view.depth} has another size than its picture; delete the record and capture again."
                )
            depth = (z.astype(np.float32) * np.float32(DEPTH_UNIT)).astype(np.float32)
        return Picture(rgba[..., :3].astype(np.float32) / 255, rgba[..., 3].astype(np.float32) / 255, depth)


def encode_rgba(rgb: np.ndarray, mask: np.ndarray) -> bytes:
    """PNG bytes of straight color [H, W, 3] and mask [H, W], 0..1."""
    from PIL import Image

    data = np.concatenate([rgb, mask[..., None]], -1)
    if not np.isfinite(data).all():
        raise ShapeError("A rendered picture has values that are not finite; it was not written.")
    data[mask <= 0, :3] = 0.0
    buffer = io.BytesIO()
    Image.fromarray(np.round(np.clip(data, 0, 1) * 255).astype(np.uint8), "RGBA").save(buffer, "PNG", compress_level=4)
    return buffer.getvalue()


def encode_depth(depth: np.ndarray) -> bytes:
    """16-bit PNG bytes of depth in metres, [H, W]."""
    from PIL import Image

    buffer = io.BytesIO()
    values = np.round(np.clip(depth / DEPTH_UNIT, 0, 65535)).astype(np.uint16)
    Image.fromarray(values).save(buffer, "PNG", compress_level=4)
    return buffer.getvalue()


def _decode(path: Path) -> np.ndarray:
    from PIL import Image

    data = read_bytes(path)
    try:
        with Image.open(io.BytesIO(data)) as image:
            return np.asarray(image)
    except (OSError, ValueError, SyntaxError) as error:
        raise FileFormatError(f"{path} is a damaged picture; delete the record beside it and run the capture again.") from error


def _read_shot(path: Path) -> Shot:
    values = _json(path)
    try:
        arrays, _ = read_npz(path.with_suffix(".npz"), ("aligned", "expression", "pose"))
        aligned, expression, pose = (_finite(arrays[name], name) for name in ("aligned", "expression", "pose"))
        for name, array, shape in (("aligned", aligned, (len(ALIGNED_NAMES),)), ("pose", pose, POSE_SHAPE)):
            if array.shape != shape:
                raise ShapeError(f"{name} has the size {_size(array)} instead of {_size(np.zeros(shape))}")
        if expression.ndim != 1 or not len(expression):
            raise ShapeError(f"expression has the size {_size(expression)}")
        views = tuple(
            View(v["name"], camera_from_json(v["camera"]), v["image"], v["depth"], v["split"]) for v in values["views"]
        )
        return Shot(values["subject"], int(values["number"]), values["kind"], aligned, expression, pose, views, path.parent)
    except FileAccessError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError, ShapeError, FileFormatError) as error:
        raise FileFormatError(f"{path} is damaged ({_reason(error)}); delete it and run the capture again.") from error


def _finite(values: np.ndarray, name: str) -> np.ndarray:
    if values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise ShapeError(f"{name} has values that are not finite numbers")
    return values


def _size(values: np.ndarray) -> str:
    return "x".join(map(str, values.shape)) or "1 number"


def _reason(error: Exception) -> str:
    """What a library says, to stand inside our sentence."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def _json(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(read_bytes(path, limit=16 << 20))
    except ValueError as error:
        raise FileFormatError(f"{path} is damaged ({error}); delete it and run the capture again.") from error
    if not isinstance(values, dict):
        raise FileFormatError(f"{path} is damaged; delete it and run the capture again.")
    return values
