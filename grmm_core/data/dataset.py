"""The capture data set: pictures, masks, depth and exact parameters of people performing aligned expressions.

Written by the capture studio, read by training, evaluation and fitting; other readers turn foreign data into the same types.
Needs numpy; Pillow where pictures are touched. May not import torch or bpy.

Folder::

    dataset.json                 format, version, settings, people, splits
    subjects/NAME.json           what is known of a person; NAME.npy: shape coefficients
    subjects/NAME_groom.npz      the person's hair as strands (since version 2, where the source has it)
    shots/NAME/0003.json         one shot's record; written last, so what has a record is complete
    shots/NAME/0003.npz          aligned [60], expression [E], pose [5, 3]; since version 2 displacement [V, 3] in millimetres,
                                 what the posed mesh model lacks
    shots/NAME/0003_00.png       RGBA, straight color in display sRGB, alpha is the mask
    shots/NAME/0003_00_z.png     16-bit depth along the optical axis in 0.1 mm; 0 is background

Since version 2 a view may have layers (`layers`: part masks, albedo, normals, other lights) and a twin without hair, which is a
view of its own.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
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
from ..hair.groom import Groom
from .layers import DEPTH_UNIT, decode_layer, encode_depth, encode_layer, encode_rgba
from .types import Manifest, Picture, Shot, View

FORMAT = "grmm-capture"
VERSION = 2
READABLE = (1, 2)
POSE_SHAPE = (5, 3)
MAX_SHAPE_BYTES = 1 << 20


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write a data set's `dataset.json`, making the folder where it is missing. Raises `FileAccessError`."""
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
    if values.get("version") not in READABLE:
        raise FileFormatError(
            f"{folder} is a capture of version {values.get('version')}, this program reads up to {VERSION}; update it."
        )
    try:
        people = [list(map(str, values[key])) for key in ("subjects", "held_out_people")]
        if len(set(people[0])) < len(people[0]):
            raise ValueError("a person is listed twice")
        return Manifest(values["head"], people[0], dict(values["settings"]), people[1])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"{path} is damaged ({error}); capture again into an empty folder.") from error


def write_subject(folder: Path, name: str, shape: np.ndarray, facts: dict[str, Any], groom: Groom | None = None) -> None:
    """Write a person's shape coefficients [S], facts and hair. Raises `FileAccessError`."""
    target = folder / "subjects"
    make_folder(target)
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(shape, np.float32))
    atomic_write_bytes(target / f"{name}.npy", buffer.getvalue())
    if groom is not None:
        atomic_write_bytes(target / f"{name}_groom.npz", _npz(**groom.pack()))
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
        _write_view(record.parent, view, picture)
    arrays = {"aligned": shot.aligned, "expression": shot.expression, "pose": shot.pose}
    values = {name: array.astype(np.float32) for name, array in arrays.items()}
    if shot.displacement is not None:
        values["displacement"] = (shot.displacement * 1e3).astype(np.float16)
    atomic_write_bytes(record.with_suffix(".npz"), _npz(**values))
    record_of = {
        "subject": shot.subject,
        "number": shot.number,
        "kind": shot.kind,
        "light": shot.light,
        "views": [_view_to_json(view) for view in shot.views],
    }
    atomic_write_bytes(record, json.dumps(record_of).encode())


def _write_view(folder: Path, view: View, picture: Picture) -> None:
    atomic_write_bytes(folder / view.image, encode_rgba(picture.rgb, picture.mask))
    if view.depth and picture.depth is not None:
        atomic_write_bytes(folder / view.depth, encode_depth(picture.depth))
    for name, file in view.layers.items():
        atomic_write_bytes(folder / file, encode_layer(name, picture.layers[name], picture.mask))
    if view.bare is not None and picture.bare is not None and not view.only_bare:
        _write_view(folder, view.bare, picture.bare)


def _view_to_json(view: View) -> dict[str, Any]:
    values: dict[str, Any] = {"name": view.name, "image": view.image, "depth": view.depth, "split": view.split}
    if view.layers:
        values["layers"] = view.layers
    if view.bare is not None:
        values["bare"] = {"image": view.bare.image, "depth": view.bare.depth, "layers": view.bare.layers}
    return {**values, "camera": camera_to_json(view.camera)}


def _view_from_json(values: dict[str, Any]) -> View:
    name, split, camera = str(values["name"]), str(values["split"]), camera_from_json(values["camera"])

    def view(own: dict[str, Any], bare: View | None = None) -> View:
        layers = {str(layer): _file(file) for layer, file in own.get("layers", {}).items()}
        return View(name, camera, _file(own["image"]), _file(own["depth"]), split, layers, bare)

    return view(values, view(values["bare"]) if "bare" in values else None)


def _file(name: Any) -> str:
    """A file's name in the record's own folder, "" for none. Raises `ValueError` for anything else."""
    if not isinstance(name, str) or Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name:
        raise ValueError(f"{str(name)[:60]!r} is no file beside it")
    return name


def _npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """A camera as JSON values: the matrix [4, 4] as lists (metres), intrinsics and size in pixels."""
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

    def layer(self, shot: Shot, view: View, name: str) -> np.ndarray:
        """Decode a layer of a view, float32, as `layers.encode_layer` describes it.

        Raises:
            FileAccessError: The file is missing.
            FileFormatError: The view has no such layer, or it is damaged.
        """
        if name not in view.layers:
            raise FileFormatError(f"The views of {shot.folder} have no {name}; capture with --layers.")
        return decode_layer(name, _decode(shot.folder / view.layers[name]), view.camera.height, view.camera.width)

    def groom(self, subject: str) -> Groom | None:
        """The strands of a person; None where the source has none. Raises `FileAccessError`, `FileFormatError`."""
        path = self.folder / "subjects" / f"{subject}_groom.npz"
        if not path.exists():
            return None
        try:
            return Groom.unpack(read_npz(path)[0])
        except ShapeError as error:
            raise FileFormatError(f"{path} is damaged ({error}); delete it and capture the person again.") from error


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
        arrays, _ = read_npz(path.with_suffix(".npz"), ("aligned", "expression", "pose", "displacement"))
        aligned, expression, pose = (_finite(arrays[name], name) for name in ("aligned", "expression", "pose"))
        for name, array, shape in (("aligned", aligned, (len(ALIGNED_NAMES),)), ("pose", pose, POSE_SHAPE)):
            if array.shape != shape:
                raise ShapeError(f"{name} has the size {_size(array)} instead of {_size(np.zeros(shape))}")
        if expression.ndim != 1 or not len(expression):
            raise ShapeError(f"expression has the size {_size(expression)}")
        moved = None
        if "displacement" in arrays:
            moved = _finite(arrays["displacement"], "displacement").astype(np.float32) * np.float32(1e-3)
            if moved.ndim != 2 or moved.shape[1] != 3:
                raise ShapeError(f"displacement has the size {_size(moved)}")
        views = tuple(_view_from_json(v) for v in values["views"])
        return Shot(
            str(values["subject"]), int(values["number"]), str(values["kind"]), aligned, expression, pose, views, path.parent,
            moved, dict(values.get("light", {})),
        )  # fmt: skip
    except FileAccessError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, ShapeError, FileFormatError) as error:
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
