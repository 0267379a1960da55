"""Splats in glTF: the extension KHR_gaussian_splatting on a point primitive.

Attributes POSITION, KHR_gaussian_splatting:ROTATION (xyzw), :SCALE, :OPACITY (0..1) and :SH_DEGREE_l_COEF_n. An early draft
stored the logarithm of the scale; the present text says linear: where any SCALE is negative it is taken as a logarithm. COLOR_0
is written beside it, as the fallback that viewers without the extension draw as points. y is up. Needs numpy only.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from ...files.format import Format
from ...geometry.rotations import matrix_to_quaternion, multiply_quaternions, quaternion_to_matrix
from ..glb import GltfReader, GltfWriter
from .cloud import MAX_DEGREE, MAX_SPLATS, SH_C0, SplatCloud, exp_scale, finish_reading

KIND = "glTF splat file"
EXTENSION = "KHR_gaussian_splatting"
_POINTS = 0
_MAX_NODES = 10_000


def read_gltf_splats(path: Path) -> SplatCloud:
    """Read all splat primitives of a `.glb` or `.gltf`, placed as the scene's nodes place them.

    Raises:
        FileFormatError: Damaged, or without splats.
        FileAccessError: Missing or unreadable.
    """
    reader = GltfReader(path, kind=KIND)
    found: list[tuple[dict[str, Any], np.ndarray, bool]] = []  # attributes, placement, linear colors
    count = 0
    for mesh_index, matrix in _placed_meshes(reader):
        primitives = reader.item("meshes", mesh_index).get("primitives", [])
        if not isinstance(primitives, list):
            raise reader.bad("its primitives are malformed")
        for primitive in primitives:
            if isinstance(primitive, dict) and isinstance(primitive.get("attributes"), dict) and _is_splats(primitive):
                found.append((primitive["attributes"], matrix, _is_linear(primitive)))
                count += reader.integer(reader.item("accessors", primitive["attributes"].get("POSITION")), "count")
                if count > MAX_SPLATS:  # a file may name one array thousands of times
                    raise reader.bad(f"it has more than {MAX_SPLATS} splats")
    if not found:
        raise reader.bad(f"it has no {EXTENSION} primitive; it may be an ordinary mesh")
    clouds = []
    for attributes, matrix, linear in found:
        cloud = _read_primitive(reader, attributes)
        clouds.append(_transform(reader, _to_display(cloud) if linear else cloud, matrix))
    return finish_reading(path, KIND, _join(clouds))


def _is_splats(primitive: dict[str, Any]) -> bool:
    extensions = primitive.get("extensions")
    named = isinstance(extensions, dict) and EXTENSION in extensions
    return named or any(str(name).startswith(EXTENSION) for name in primitive["attributes"])


def _is_linear(primitive: dict[str, Any]) -> bool:
    """Whether the reconstructed colors are linear instead of display sRGB."""
    extensions = primitive.get("extensions")
    settings = extensions.get(EXTENSION) if isinstance(extensions, dict) else None
    return isinstance(settings, dict) and settings.get("colorSpace") == "lin_rec709_display"


def _to_display(cloud: SplatCloud) -> SplatCloud:
    """Take linear colors to display sRGB: the constant ones exactly, what depends on the view by the curve's slope there."""
    linear = np.clip(cloud.colors(), 1e-4, 1.0)
    low = linear <= 0.0031308
    display = np.where(low, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    slope = np.where(low, 12.92, 1.055 / 2.4 * linear ** (1 / 2.4 - 1))
    cloud.sh = cloud.sh * slope[:, None]
    cloud.sh[:, 0] = (display - 0.5) / SH_C0
    cloud.sh = cloud.sh.astype(np.float32)
    cloud.warnings.append("Its colors are linear and were turned to display colors.")
    return cloud


def _read_primitive(reader: GltfReader, attributes: dict[str, Any]) -> SplatCloud:
    def place_of(name: str) -> Any:
        return attributes.get(name if name == "POSITION" else f"{EXTENSION}:{name}", attributes.get(f"_{name}"))

    def get(name: str, width: int) -> np.ndarray:
        index = place_of(name)
        if index is None:
            raise reader.bad(f"a splat primitive has no attribute {name}")
        values = reader.accessor(index)
        if (values.ndim == 1) != (width == 1) or (width > 1 and values.shape[1] != width):
            raise reader.bad(f"attribute {name} is not {width} values a splat")
        return values.astype(np.float32)

    means, quats, scales = get("POSITION", 3), get("ROTATION", 4), get("SCALE", 3)
    opacities = get("OPACITY", 1)
    count = means.shape[0]
    terms: list[np.ndarray] = []
    for degree in range(MAX_DEGREE + 1):
        names = [f"SH_DEGREE_{degree}_COEF_{n}" for n in range(2 * degree + 1)]
        if degree and any(place_of(name) is None for name in names):
            break
        terms += [get(name, 3) for name in names]
    if any(array.shape[0] != count for array in (quats, scales, opacities, *terms)):
        raise reader.bad("attributes of a splat primitive differ in length")
    warnings = []
    if (scales < 0).any():
        scales = exp_scale(scales)
        warnings.append("Scales are negative, so they were read as logarithms, as in an early draft of the format.")
    return SplatCloud(means, quats[:, [3, 0, 1, 2]], scales, opacities, np.stack(terms, 1), warnings=warnings)


def _placed_meshes(reader: GltfReader) -> list[tuple[int, np.ndarray]]:
    """Mesh index and world matrix [4, 4] of every node with a mesh; all meshes at the origin where there are no nodes."""
    nodes = reader.items("nodes")
    if not nodes:
        return [(i, np.eye(4)) for i in range(len(reader.items("meshes")))]
    if len(nodes) > _MAX_NODES:
        raise reader.bad(f"it has {len(nodes)} nodes")
    children = {child for node in nodes for child in _children(reader, node)}
    pending = [(i, np.eye(4)) for i in range(len(nodes)) if i not in children]
    seen: set[int] = set()
    placed = []
    while pending:
        index, parent = pending.pop()
        if index in seen:
            raise reader.bad("its nodes form a loop")
        seen.add(index)
        node = reader.item("nodes", index)
        matrix = parent @ _local_matrix(reader, node)
        if "mesh" in node:
            placed.append((reader.integer(node, "mesh"), matrix))
        pending += [(child, matrix) for child in _children(reader, node)]
    return placed[::-1]


def _children(reader: GltfReader, node: dict[str, Any]) -> list[int]:
    children = node.get("children", [])
    if not isinstance(children, list) or any(type(child) is not int for child in children):
        raise reader.bad("its nodes are malformed")
    return children


def _local_matrix(reader: GltfReader, node: dict[str, Any]) -> np.ndarray:
    try:
        if "matrix" in node:
            return np.array(node["matrix"], np.float64).reshape(4, 4).T
        matrix = np.eye(4)
        x, y, z, w = (float(v) for v in node.get("rotation", (0, 0, 0, 1)))
        if x * x + y * y + z * z + w * w < 1e-12:
            raise ValueError("zero rotation")
        scale = np.array(node.get("scale", (1, 1, 1)), np.float64).reshape(3)
        matrix[:3, :3] = quaternion_to_matrix(np.array([w, x, y, z])) * scale
        matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), np.float64).reshape(3)
    except (TypeError, ValueError, OverflowError) as error:
        raise reader.bad("a node's placement is malformed") from error
    return matrix


def _transform(reader: GltfReader, cloud: SplatCloud, matrix: np.ndarray) -> SplatCloud:
    """Move splats by a rotation, translation and uniform scale. Higher harmonics are kept only without a rotation."""
    if np.allclose(matrix, np.eye(4)):
        return cloud
    linear = matrix[:3, :3]
    determinant = float(np.linalg.det(linear)) if np.isfinite(matrix).all() else 0.0
    if not 1e-18 < determinant < 1e18:
        raise reader.bad("a node's placement is mirrored or not finite, which splats cannot follow")
    size = determinant ** (1 / 3)
    rotation = linear / size
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        raise reader.bad("a node's scale differs between axes, which splats cannot follow")
    cloud.means = (cloud.means @ linear.T + matrix[:3, 3]).astype(np.float32)
    cloud.scales = (cloud.scales * size).astype(np.float32)
    cloud.quats = multiply_quaternions(matrix_to_quaternion(rotation)[None], cloud.quats).astype(np.float32)
    if cloud.sh.shape[1] > 1 and not np.allclose(rotation, np.eye(3), atol=1e-4):
        cloud.sh = cloud.sh[:, :1]
        cloud.warnings.append("View-dependent color was dropped, since its node is turned.")
    return cloud


def _join(clouds: list[SplatCloud]) -> SplatCloud:
    """Concatenate clouds, at the lowest of their degrees."""
    if len(clouds) == 1:
        return clouds[0]
    terms = min(cloud.sh.shape[1] for cloud in clouds)
    names = ("means", "quats", "scales", "opacities")
    means, quats, scales, opacities = (np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names)
    sh = np.concatenate([cloud.sh[:, :terms] for cloud in clouds])
    return SplatCloud(means, quats, scales, opacities, sh, warnings=[text for cloud in clouds for text in cloud.warnings])


def write_gltf_splats(path: str | os.PathLike[str], cloud: SplatCloud) -> None:
    """Write a `.glb` with one splat primitive. Raises `ShapeError` and `FileAccessError`."""
    cloud = cloud.validated()
    writer = GltfWriter()
    rgba = np.concatenate([np.clip(cloud.colors(), 0.0, 1.0), cloud.opacities[:, None]], 1)
    attributes = {
        "POSITION": writer.add_array(cloud.means, bounds=True),
        "COLOR_0": writer.add_array(_to_linear(rgba)),
        f"{EXTENSION}:ROTATION": writer.add_array(cloud.quats[:, [1, 2, 3, 0]]),
        f"{EXTENSION}:SCALE": writer.add_array(cloud.scales),
        f"{EXTENSION}:OPACITY": writer.add_array(cloud.opacities),
    }
    term = 0
    for degree in range(cloud.degree + 1):
        for n in range(2 * degree + 1):
            attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}"] = writer.add_array(cloud.sh[:, term])
            term += 1
    settings = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective"}
    settings["sortingMethod"] = "cameraDistance"
    primitive = {"mode": _POINTS, "attributes": attributes, "extensions": {EXTENSION: settings}}
    mesh = writer.add("meshes", {"primitives": [primitive]})
    node = writer.add("nodes", {"mesh": mesh, "name": "splats"})
    writer.add("scenes", {"nodes": [node]})
    writer.document |= {"scene": 0, "extensionsUsed": [EXTENSION]}
    writer.write(path)


def _to_linear(rgba: np.ndarray) -> np.ndarray:
    """COLOR_0 is linear in glTF: undo the sRGB curve of the colors, keep alpha. [N, 4]."""
    rgb = rgba[:, :3]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return np.concatenate([linear, rgba[:, 3:]], 1).astype(np.float32)


def _recognises(path: Path, start: bytes) -> bool:
    return EXTENSION in json.dumps(GltfReader(path).document.get("extensionsUsed"))


FORMAT = Format(
    "gltf-splats", "glTF (.glb)", "glTF with KHR_gaussian_splatting", "splats",
    (".glb",), read_gltf_splats, write_gltf_splats, _recognises, (".gltf",),
)  # fmt: skip
