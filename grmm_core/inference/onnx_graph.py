"""ONNX models made in memory: the few fields of the format that a network of convolutions needs.

onnxruntime takes a model as serialised protocol buffers. The package that usually writes them is larger than everything else
here together and is needed for nothing else, while the wire format is simple: a field is a key (number and kind) and a
value; messages, texts and packed arrays carry their length. Field numbers are those of `onnx.proto` (ONNX 1.15, IR version 9).

Used by `onnx_networks` only. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

IR_VERSION = 9
OPSET_VERSION = 19
_FLOAT, _INT64 = 1, 7  # TensorProto.DataType
_ELEMENT_TYPES = {"float32": _FLOAT, "int64": _INT64}
_ATTRIBUTE_FLOAT, _ATTRIBUTE_INT, _ATTRIBUTE_STRING, _ATTRIBUTE_INTS = 1, 2, 3, 7  # AttributeProto.AttributeType
_VARINT, _LENGTH, _FIXED32 = 0, 2, 5  # wire types

Attribute = int | float | str | Sequence[int]


class OnnxGraph:
    """A graph under construction; values are known by their names.

    Args:
        name: Shows in onnxruntime's messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._inputs: list[bytes] = []
        self._nodes: list[bytes] = []
        self._constants: list[bytes] = []
        self._count = 0

    def input(self, name: str, shape: Sequence[int | str]) -> str:
        """Declare a float32 input; sides that are texts are found at run time."""
        self._inputs.append(_value_info(name, shape))
        return name

    def constant(self, array: np.ndarray) -> str:
        """Add a float32 or int64 array."""
        name = self._new_name("c")
        kind = _ELEMENT_TYPES[array.dtype.name]
        dims = b"".join(_varint_field(1, side) for side in array.shape)
        raw = _bytes_field(9, np.ascontiguousarray(array).tobytes())
        self._constants.append(dims + _varint_field(2, kind) + _text_field(8, name) + raw)
        return name

    def node(self, operator: str, *inputs: str, **attributes: Attribute) -> str:
        """Add an operator of the standard set with one output, whose name is returned; an empty input is left out."""
        output = self._new_name("v")
        parts = [_text_field(1, name) for name in inputs]
        parts += [_text_field(2, output), _text_field(4, operator)]
        parts += [_bytes_field(5, _attribute(name, value)) for name, value in attributes.items()]
        self._nodes.append(b"".join(parts))
        return output

    def serialise(self, output: str, shape: Sequence[int | str]) -> bytes:
        """Return the model whose only output is the named value, float32 of the given shape."""
        graph = b"".join(_bytes_field(1, node) for node in self._nodes) + _text_field(2, self._name)
        graph += b"".join(_bytes_field(5, constant) for constant in self._constants)
        graph += b"".join(_bytes_field(11, value) for value in self._inputs) + _bytes_field(12, _value_info(output, shape))
        operators = _text_field(1, "") + _varint_field(2, OPSET_VERSION)
        return _varint_field(1, IR_VERSION) + _bytes_field(7, graph) + _bytes_field(8, operators)

    def _new_name(self, prefix: str) -> str:
        self._count += 1
        return f"{prefix}{self._count}"


def _attribute(name: str, value: Attribute) -> bytes:
    head = _text_field(1, name)
    if isinstance(value, float):
        return head + _key(2, _FIXED32) + np.float32(value).tobytes() + _varint_field(20, _ATTRIBUTE_FLOAT)
    if isinstance(value, int):
        return head + _varint_field(3, value) + _varint_field(20, _ATTRIBUTE_INT)
    if isinstance(value, str):
        return head + _text_field(4, value) + _varint_field(20, _ATTRIBUTE_STRING)
    return head + b"".join(_varint_field(8, item) for item in value) + _varint_field(20, _ATTRIBUTE_INTS)


def _value_info(name: str, shape: Sequence[int | str]) -> bytes:
    sides = b"".join(
        _bytes_field(1, _text_field(2, side) if isinstance(side, str) else _varint_field(1, side)) for side in shape
    )
    tensor = _varint_field(1, _FLOAT) + _bytes_field(2, sides)
    return _text_field(1, name) + _bytes_field(2, _bytes_field(1, tensor))


def _key(number: int, wire_type: int) -> bytes:
    return _varint(number << 3 | wire_type)


def _varint_field(number: int, value: int) -> bytes:
    return _key(number, _VARINT) + _varint(value)


def _bytes_field(number: int, value: bytes) -> bytes:
    return _key(number, _LENGTH) + _varint(len(value)) + value


def _text_field(number: int, value: str) -> bytes:
    return _bytes_field(number, value.encode())


def _varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first; negative numbers as 64-bit two's complement."""
    value &= (1 << 64) - 1
    result = bytearray()
    while value > 0x7F:
        result.append(value & 0x7F | 0x80)
        value >>= 7
    result.append(value)
    return bytes(result)
