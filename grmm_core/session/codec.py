"""Messages between a session and its worker: JSON behind a length, arrays in the shared arena. No pickle.

A message is four bytes (little-endian length) and a JSON object in UTF-8. Arrays inside it are replaced by a description of
their place in the arena, the interface's own classes by their fields. Decoding builds only the types listed here.

Used by `client` and `worker`. Needs numpy only.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import struct
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from ..controls.frame import Controls
from ..errors import SessionError
from ..geometry.camera import Camera
from ..hair.groom import Groom
from ..hair.settings import HairSettings
from ..light.lamps import Area, Lighting, Point, Spot, Sun
from ..light.shading import Response
from ..light.surroundings import SunSpot, Surroundings
from ..splat.types import GaussianArrays
from .arena import SharedArena
from .values import AvatarInfo, CloudArrays, Deformation, Instance, RenderOptions, SessionStatus
from .wearing import HairUse

MAX_MESSAGE_BYTES = 16 << 20
_LENGTH = struct.Struct("<I")
_TYPES = {
    kind.__name__: kind
    for kind in (
        Camera,
        Controls,
        AvatarInfo,
        CloudArrays,
        Deformation,
        GaussianArrays,
        Groom,
        HairSettings,
        HairUse,
        Instance,
        RenderOptions,
        Response,
        SessionStatus,
        Area,
        Lighting,
        Point,
        Spot,
        Sun,
        SunSpot,
        Surroundings,
    )
}
_KINDS = frozenset(_TYPES.values())
_PLAIN = frozenset({str, int, float, bool, type(None)})  # most of a message, as it is in JSON
_DTYPES = frozenset({"<f4", "<f8", "<i4", "<i8", "|u1", "|b1"})


def send(stream: BinaryIO, message: Mapping[str, Any], arena: SharedArena | None = None, turned: bool = False) -> None:
    """Write one message; its arrays go to the arena first, without one into the message itself.

    Args:
        stream: Where to.
        message: Names and values.
        arena: Memory that both sides share.
        turned: Arrays lie in the arena from their last row to the first, as Blender's pictures do. The other side sees them as
            they are, and copies of its own in Blender's order cost it nothing.

    Raises:
        OSError, ValueError: The other side is gone (broken pipe, closed stream).
        SessionError: No room for the arrays.
    """
    arrays: list[np.ndarray] = []
    tree = _pack(message, arrays)
    if arena is not None:
        offsets = arena.write([_turned(a) for a in arrays] if turned else arrays)
        tree["$arena"] = arena.spec()
        tree["$turned"] = turned
        tree["$arrays"] = [[a.dtype.str, list(a.shape), offset] for a, offset in zip(arrays, offsets, strict=True)]
    elif arrays:
        tree["$arrays"] = [[a.dtype.str, list(a.shape), base64.b64encode(a.tobytes()).decode("ascii")] for a in arrays]
    data = json.dumps(tree).encode()
    stream.write(_LENGTH.pack(len(data)) + data)
    stream.flush()


def receive(stream: BinaryIO) -> dict[str, Any] | None:
    """Read one message without its arrays (see `unpack`); None when the other side has closed the stream.

    Raises:
        SessionError: What came is not a message.
    """
    prefix = _read_exactly(stream, _LENGTH.size)
    if prefix is None:
        return None
    (length,) = _LENGTH.unpack(prefix)
    if length > MAX_MESSAGE_BYTES:
        raise SessionError("The model worker sent something that is not a message; check which Python is set for it.")
    data = _read_exactly(stream, length)
    if data is None:
        return None
    try:
        message = json.loads(data)
    except ValueError as error:
        raise SessionError("The model worker sent a damaged message; try again.") from error
    if not isinstance(message, dict):
        raise SessionError("The model worker sent a damaged message; try again.")
    return message


def unpack(message: dict[str, Any], arena: SharedArena | None) -> dict[str, Any]:
    """Replace the descriptions in a received message by arrays (copies) and dataclasses."""
    spec, turned = message.pop("$arena", None), message.pop("$turned", False)
    places = message.pop("$arrays", [])
    arrays: list[np.ndarray] = []
    if arena is not None and spec is not None:
        arena.follow(spec)
    for dtype, shape, place in places:
        if dtype not in _DTYPES:
            raise SessionError(f"The model worker sent an array of the unknown type {dtype!r}; check the installation.")
        if isinstance(place, str):
            arrays.append(np.frombuffer(base64.b64decode(place), dtype).reshape(shape))
        elif arena is not None:
            found = arena.read(dtype, tuple(shape), place)
            arrays.append(_turned(found) if turned else found)
    return {name: _unpack(value, arrays) for name, value in message.items()}


def digest(value: Any) -> tuple[str, int]:
    """Return what equal messages, and hardly any others, have in common, and the bytes of their arrays."""
    arrays: list[np.ndarray] = []
    content = hashlib.sha256(json.dumps(_pack(value, arrays)).encode())
    for array in arrays:
        content.update(array.tobytes())
    return content.hexdigest(), sum(array.nbytes for array in arrays)


def _turned(array: np.ndarray) -> np.ndarray:
    return array[::-1] if array.ndim else array


def _pack(value: Any, arrays: list[np.ndarray]) -> Any:
    kind = type(value)
    if kind in _PLAIN:
        return value
    if isinstance(value, np.ndarray):
        arrays.append(np.ascontiguousarray(value))
        return {"$array": len(arrays) - 1}
    if kind in _KINDS:
        names = value._fields if isinstance(value, GaussianArrays) else [field.name for field in dataclasses.fields(value)]
        fields = {name: _pack(getattr(value, name), arrays) for name in names}
        return {"$type": kind.__name__, "fields": fields}
    if isinstance(value, bytes):
        return {"$bytes": base64.b64encode(value).decode("ascii")}
    if isinstance(value, Mapping):
        return {str(name): _pack(item, arrays) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_pack(item, arrays) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return value


def _unpack(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, list):
        return [_unpack(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    if "$array" in value:
        return arrays[value["$array"]]
    if "$bytes" in value:
        return base64.b64decode(value["$bytes"])
    if "$type" in value:
        kind = _TYPES.get(value["$type"])
        if kind is None:
            raise SessionError(f"The model worker sent the unknown type {value['$type']!r}; check the installation.")
        return kind(**{name: _unpack(item, arrays) for name, item in value["fields"].items()})
    return {name: _unpack(item, arrays) for name, item in value.items()}


def _read_exactly(stream: BinaryIO, count: int) -> bytes | None:
    parts = []
    while count:
        part = stream.read(count)
        if not part:
            return None
        parts.append(part)
        count -= len(part)
    return b"".join(parts)
