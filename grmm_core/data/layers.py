"""Layers of a picture beside color, mask and depth, as PNG bytes: part masks, albedo, normals, the picture under other light.

Used by `dataset`. Needs numpy and Pillow.
"""

from __future__ import annotations

import io

import numpy as np

from ..errors import FileFormatError, ShapeError

PARTS = ("skin", "hair", "brows", "beard", "lashes", "eyes", "teeth", "mouth", "clothes")
PART_LAYER, ALBEDO, NORMAL = "parts", "albedo", "normal"
LIGHT_PREFIX = "light_"  # of the layers that show the same shot in another light
DEPTH_UNIT = 1e-4  # metres


def encode_rgba(rgb: np.ndarray, mask: np.ndarray) -> bytes:
    """PNG bytes of straight color [H, W, 3] and mask [H, W], 0..1."""
    data = np.concatenate([rgb, mask[..., None]], -1)
    if not np.isfinite(data).all():
        raise ShapeError("A rendered picture has values that are not finite; it was not written.")
    data[mask <= 0, :3] = 0.0
    return _png(np.round(np.clip(data, 0, 1) * 255).astype(np.uint8))


def encode_depth(depth: np.ndarray) -> bytes:
    """16-bit PNG bytes of depth in metres, [H, W]."""
    return _png(np.round(np.clip(depth / DEPTH_UNIT, 0, 65535)).astype(np.uint16))


def encode_layer(name: str, values: np.ndarray, mask: np.ndarray) -> bytes:
    """PNG bytes of a layer.

    Args:
        name: `PART_LAYER` (coverage of each of `PARTS`, 0..1, [P, H, W]), `NORMAL` (head space, [H, W, 3]), or display sRGB
            0..1, [H, W, 3].
        values: As above.
        mask: Coverage; where it is 0 nothing is kept, [H, W].
    """
    if not np.isfinite(values).all():
        raise ShapeError(f"The layer {name} has values that are not finite; it was not written.")
    if name == PART_LAYER:
        return _png(np.round(np.clip(values, 0, 1) * 255).astype(np.uint8).reshape(-1, values.shape[-1]))
    scaled = values * 0.5 + 0.5 if name == NORMAL else values
    return _png(np.round(np.clip(np.where(mask[..., None] > 0, scaled, 0), 0, 1) * 255).astype(np.uint8))


def decode_layer(name: str, stored: np.ndarray, height: int, width: int) -> np.ndarray:
    """Values of a layer as `encode_layer` takes them, float32; of normals, 0 where nothing was kept.

    Raises:
        FileFormatError: The stored pixels are not those of such a layer.
    """
    shape = (len(PARTS) * height, width) if name == PART_LAYER else (height, width, 3)
    if stored.shape != shape or stored.dtype != np.uint8:
        raise FileFormatError(f"The layer {name} has another size than its picture; delete the record and capture again.")
    values = stored.astype(np.float32) / 255
    if name == PART_LAYER:
        return values.reshape(len(PARTS), height, width)
    if name == NORMAL:
        return np.where(stored.any(-1, keepdims=True), values * 2 - 1, 0).astype(np.float32)
    return values


def _png(values: np.ndarray) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, "PNG", compress_level=4)
    return buffer.getvalue()
