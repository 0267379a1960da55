"""The head mesh of an avatar: geometry, UV map, materials, vertex groups and shape keys, in Blender's axes.

Used by `build` and, for the resting shape, by the relink operator. Drivers are set up in `drivers`.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...grmm_core.controls.frame import EXPRESSIONS_TO_ARKIT
from ...grmm_core.controls.names import ARKIT_NAMES, EXPRESSION_NAMES
from ...grmm_core.controls.table import SHAPE
from ...grmm_core.head import HeadModel, arkit_gain
from ...grmm_core.head.closing import CLOSING
from .identity import Identity
from .materials import add_materials

BASIS_KEY = "Basis"
RESIDUAL_KEY = "residual"
SHAPE_REST_KEY = "shape.rest"
LEADING_SHAPES = 50
"""Shape components with a key of their own; `live` writes the sum of the many small others into one key. A key costs Blender
0.02 ms a frame wherever it is not zero, so 300 of them would take most of a frame's time."""
DEFORM_PREFIX = "DEF-"
UV_NAME = "UVMap"
KEY_LIMIT = 10.0  # the most that Blender allows a shape key
_MIN_WEIGHT = 1e-7
_SMALLEST = 1e-8  # metres


def to_blender(points: np.ndarray) -> np.ndarray:
    """Head axes to Blender's: (x, y, z) -> (x, -z, y), [..., 3] float32."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], -1).astype(np.float32)


def expression_rows(head: HeadModel, gain: np.ndarray | None = None) -> np.ndarray:
    """Expression coefficients that each named expression stands for, [K, E].

    Args:
        head: Head model.
        gain: Of the person, [52], see `head.arkit_gain`; None: as sculpted.
    """
    rows = np.asarray(head.arkit_to_expression, np.float32)
    return EXPRESSIONS_TO_ARKIT @ (rows if gain is None else gain[:, None] * rows)


def component_of(name: str, row: np.ndarray) -> int | None:
    """Return k where a named expression, a row of `expression_rows` [E], is component k and nothing else, on everybody."""
    used = np.flatnonzero(row)
    return int(used[0]) if used.size == 1 and row[used[0]] == 1.0 and name not in CLOSING else None


def shape_key_name(index: int) -> str:
    """Name of the shape key of a shape component."""
    return f"{SHAPE}.{index}"


def make_mesh(name: str, identity: Identity) -> bpy.types.Mesh:
    """Return a mesh in the avatar's resting shape, with UV map and materials, without users."""
    head = identity.head
    mesh = bpy.data.meshes.new(name)
    faces = np.asarray(head.faces, np.int32)
    mesh.vertices.add(head.vertex_count)
    mesh.loops.add(faces.size)
    mesh.polygons.add(len(faces))
    mesh.vertices.foreach_set("co", to_blender(identity.vertices).ravel())
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
    layer = mesh.uv_layers.new(name=UV_NAME)
    layer.data.foreach_set("uv", np.asarray(head.uv, np.float32)[head.uv_faces.ravel()].ravel())
    add_materials(mesh, identity)
    mesh.update()
    return mesh


def add_vertex_groups(obj: bpy.types.Object, head: HeadModel) -> None:
    """Write the skinning weights as vertex groups named after the deforming bones."""
    for joint, name in enumerate(head.joint_names):
        group = obj.vertex_groups.new(name=DEFORM_PREFIX + name)
        weights = head.weights[:, joint]
        # equal weights in one call: most vertices follow one joint wholly
        values, inverse = np.unique(weights, return_inverse=True)
        for index, value in enumerate(values):
            if value > _MIN_WEIGHT:
                group.add(np.flatnonzero(inverse == index).tolist(), float(value), "REPLACE")


def add_shape_keys(obj: bpy.types.Object, identity: Identity) -> None:
    """Add the basis and all keys, at 0; those that `live` writes are at 1 and hold nothing yet."""
    head = identity.head
    resting = to_blender(identity.vertices)
    _add_key(obj, BASIS_KEY, resting)
    for k in range(leading_shapes(head)):
        _add_key(obj, shape_key_name(k), resting + to_blender(head.shape_dirs[:, :, k]))
    for k, name in enumerate(head.expression_names):
        _add_key(obj, name, resting + to_blender(head.expression_dirs[:, :, k]))
    add_recipe_keys(obj, head, identity.shape)
    for name in (SHAPE_REST_KEY, RESIDUAL_KEY):
        _add_key(obj, name, resting).value = 1.0


def add_recipe_keys(obj: bpy.types.Object, head: HeadModel, shape: np.ndarray) -> None:
    """Add the keys of named expressions that are more than one component of the head, where they are missing.

    Args:
        obj: Head object.
        head: Its model.
        shape: The person's own coefficients, [<=S].
    """
    keys = obj.data.shape_keys.key_blocks
    resting = read_key(keys[BASIS_KEY]).reshape(-1, 3)
    for name, row in zip(EXPRESSION_NAMES, expression_rows(head, arkit_gain(head, shape)), strict=True):
        key = recipe_key_name(name, head)
        if component_of(name, row) is None and key not in keys:
            _add_key(obj, key, resting + to_blender(head.expression_dirs @ row))


def fit_recipe_keys(obj: bpy.types.Object, head: HeadModel, shape: np.ndarray) -> None:
    """Let the keys with `CLOSING` shapes in them go as far as a person's must; arguments as `add_recipe_keys`."""
    own = [ARKIT_NAMES.index(name) for name in CLOSING]
    rows = expression_rows(head, arkit_gain(head, shape))
    for name, row, parts in zip(EXPRESSION_NAMES, rows, EXPRESSIONS_TO_ARKIT, strict=True):
        if parts[own].any():
            write_offsets(obj, recipe_key_name(name, head), to_blender(head.expression_dirs @ row).ravel())


def has_closing_keys(obj: bpy.types.Object, head: HeadModel) -> bool:
    """Whether a head has keys for what shuts its own eyes and lips; those of earlier versions have the sculpted ones alone."""
    return all(recipe_key_name(name, head) in obj.data.shape_keys.key_blocks for name in CLOSING)


def gain_of(obj: bpy.types.Object, head: HeadModel) -> np.ndarray:
    """How far the ARKit shapes go on a head, [52], as its keys have it; 1 where it has none of its own."""
    keys, gain, rows = obj.data.shape_keys.key_blocks, np.ones(len(ARKIT_NAMES), np.float32), expression_rows(head)
    basis = read_key(keys[BASIS_KEY])
    for name in CLOSING:
        key = keys.get(recipe_key_name(name, head))
        whole = to_blender(head.expression_dirs @ rows[EXPRESSION_NAMES.index(name)]).ravel()
        if key is not None and whole.any():
            gain[ARKIT_NAMES.index(name)] = (read_key(key) - basis) @ whole / (whole @ whole)
    return gain


def leading_shapes(head: HeadModel) -> int:
    """Number of shape components with a key of their own."""
    return min(LEADING_SHAPES, head.shape_count)


def recipe_key_name(name: str, head: HeadModel) -> str:
    """Name of the key of a named expression that has its own; an expression component may have taken the plain name."""
    return f"aligned.{name}" if name in head.expression_names else name


def rebase(obj: bpy.types.Object, vertices: np.ndarray) -> None:
    """Move the resting mesh and all keys with it, so that the avatar of `obj` becomes another person.

    Args:
        obj: Head object.
        vertices: New resting mesh, head space, [V, 3].
    """
    keys = obj.data.shape_keys.key_blocks
    wanted = to_blender(vertices)
    shift = wanted.ravel() - read_key(keys[BASIS_KEY])
    for key in keys:
        key.points.foreach_set("co", read_key(key) + shift)
    obj.data.vertices.foreach_set("co", wanted.ravel())
    obj.data.update()


def read_key(key: bpy.types.ShapeKey) -> np.ndarray:
    """Positions of a shape key, flat, [3 V] float32."""
    positions = np.empty(len(key.points) * 3, np.float32)
    key.points.foreach_get("co", positions)  # `points` is the fast path of `data`
    return positions


def write_offsets(obj: bpy.types.Object, name: str, offsets: np.ndarray) -> bool:
    """Set a key to the basis plus offsets, and have the mesh evaluated again.

    Args:
        obj: Head object.
        name: Key; where it was removed nothing happens.
        offsets: Blender's axes, flat, metres, [3 V].

    Returns:
        Whether anything changed by more than 1e-8 m.
    """
    keys = obj.data.shape_keys.key_blocks
    key = keys.get(name)
    if key is None or len(key.points) * 3 != offsets.size:
        return False
    return write_key(obj, name, read_key(keys[BASIS_KEY]) + offsets)


def write_key(obj: bpy.types.Object, name: str, positions: np.ndarray) -> bool:
    """Set a key that exists to positions [3 V]; see `write_offsets`."""
    key = obj.data.shape_keys.key_blocks[name]
    if np.abs(read_key(key) - positions).max(initial=0.0) < _SMALLEST:
        return False
    key.points.foreach_set("co", positions)
    obj.data.update_tag()
    return True


def evaluated_key(obj: bpy.types.Object, name: str, depsgraph: bpy.types.Depsgraph) -> bpy.types.ShapeKey | None:
    """The evaluated scene's copy of a key, or None where it has none (yet)."""
    keys = obj.data.shape_keys.evaluated_get(depsgraph)
    key = keys.key_blocks.get(name) if keys.is_evaluated else None
    return key if key is not None and len(key.points) == len(obj.data.vertices) else None


def _add_key(obj: bpy.types.Object, name: str, positions: np.ndarray) -> bpy.types.ShapeKey:
    key = obj.shape_key_add(name=name, from_mix=False)
    key.slider_min, key.slider_max = -KEY_LIMIT, KEY_LIMIT
    key.value = 0.0
    key.points.foreach_set("co", positions.ravel())
    return key
