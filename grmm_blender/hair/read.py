"""From a Curves object to strands: what Blender evaluates of it, whoever made it and whatever its modifiers do.

Light inside hair and levels of detail come from the groom at rest. That is the object's own curves, bound to the head's resting
mesh, as long as what is evaluated has the same curves; then a frame costs its points. Geometry nodes that add or remove curves
leave no rest: the groom is then bound in the frame itself, and kept while no point goes farther than `SAME_REST` from it. While
curves are combed, the groom of before gives the light of the new points.

An object that is hidden, and so not evaluated, still is hair: its strands follow the head as those of the package do.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace

import bpy
import numpy as np
from mathutils import Matrix

from ...grmm_core.avatar import AssetReference
from ...grmm_core.errors import GrmmError, ShapeError
from ...grmm_core.hair import Groom, groom_from_curves
from ...grmm_core.hair.groom import MAX_POINTS
from ...grmm_core.hair.roots import BEARD, BROWS, GROUPS, LASHES, RootFrames
from ...grmm_core.session import HEAD_TO_BLENDER
from ..rig.identity import load_head
from .curve_children import CHILD
from .curve_sliders import MODIFIER_NAME, PART, follows_sliders, keeps_course, shared_with
from .strands import StrandShot

DEFORM_NODE = "GeometryNodeDeformCurvesOnSurface"
UV_COORDINATE = "surface_uv_coordinate"  # Blender's name for the place of a root
TINT = "grmm_tint"  # what is added to a point's color, see `Groom.tints`; may be below 0, and so is no color of Blender's
HELD = {GROUPS[group]: group for group in (BROWS, BEARD, LASHES)}  # parts that curves have besides the scalp's hair
HELD_PREFIX = "grmm_"  # before their names: the panel's choice that curves were made from
MADE_OF = "grmm_made_of"  # the same of the hair itself
SAME_REST = 0.003  # metres
_NO_SIZE = 1e-18  # determinant of a scale of a millionth
_TO_HEAD = np.linalg.inv(HEAD_TO_BLENDER)


@dataclass(frozen=True, eq=False)
class _Curves:
    """Arrays of a Curves data-block, as `groom_from_curves` takes them; points in a space that the reader chose."""

    points: np.ndarray
    offsets: np.ndarray
    uv: np.ndarray | None
    radii: np.ndarray | None
    tints: np.ndarray | None
    parts: np.ndarray | None

    def matches(self, other: _Curves) -> bool:
        """Whether these are the same curves, wherever their points are."""
        names = "offsets", "uv", "radii", "tints", "parts"
        pairs = ((getattr(self, name), getattr(other, name)) for name in names)
        return all(one is two or np.array_equal(one, two) for one, two in pairs)


@dataclass(eq=False)
class _Known:
    """What was read of an object last."""

    source: _Curves
    resting: np.ndarray | None
    shot: StrandShot
    frames: RootFrames | None = field(default=None)


_known: dict[tuple[int, bool], _Known] = {}
_messages: dict[int, str] = {}


def read_strands(
    head: bpy.types.Object, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, model_to_world: np.ndarray
) -> StrandShot | None:
    """Return the strands of an object in the depsgraph's moment, None where it has no curves.

    Args:
        head: Of the avatar that wears them.
        obj: A Curves object.
        depsgraph: Evaluated scene.
        model_to_world: Head space to Blender's world, [4, 4].

    Raises:
        ShapeError: The curves cannot be hair of this head; the sentence names the object and says what to do.
    """
    obj = obj.original
    try:
        strands = _read(head, obj, depsgraph, model_to_world)
    except GrmmError as error:
        _messages[obj.session_uid] = message = f"{obj.name}: {error}"
        raise ShapeError(message) from error
    _messages.pop(obj.session_uid, None)
    return strands


def bound_strands(
    head: bpy.types.Object, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, model_to_world: np.ndarray
) -> StrandShot | None:
    """Return strands with a groom that has what modifiers do in the depsgraph's moment, for files. See `read_strands`."""
    strands = read_strands(head, obj, depsgraph, model_to_world)
    evaluated = _evaluated(obj.original, depsgraph)
    final = depsgraph.mode == "RENDER"
    idle = {MODIFIER_NAME} if keeps_course(head.grmm.hair) or not follows_sliders(obj, final) else set()
    used = [one for one in obj.modifiers if one.type == "NODES" and one.node_group and one.name not in idle]
    nodes = [node for one in used for node in one.node_group.nodes]
    only_follows = all(node.bl_idname in (DEFORM_NODE, "NodeGroupInput", "NodeGroupOutput") for node in nodes)
    if strands is None or only_follows or evaluated is None:
        return strands
    shown = _shown(obj.original, evaluated, _curves_of(obj.original.data, None), model_to_world, final)
    bound = _of_frame(head, shown, depsgraph, model_to_world, None, obj.session_uid).shot
    return replace(bound, key=f"{strands.key} bound", shaped=strands.shaped)


def message_of(obj: bpy.types.Object) -> str:
    """What was wrong with an object when it was read last, a sentence, or ""; for panels."""
    return _messages.get(obj.session_uid, "")


def forget() -> None:
    """Drop what is kept; another file is opened."""
    _known.clear()
    _messages.clear()


def _read(
    head: bpy.types.Object, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, model_to_world: np.ndarray
) -> StrandShot | None:
    surface = obj.data.surface
    if surface is None:
        raise ShapeError("The curves have no surface; choose this head as their surface, and its UV map.")
    if shared_with(head.original) is not None:
        raise ShapeError(f"The curves are the hair of {surface.name} as well and stand on it; make this head independent.")
    if surface.original != head.original:
        raise ShapeError(f"The curves stand on {surface.name}, not on this head; choose this head as their surface.")
    key, final = (obj.session_uid, depsgraph.mode == "RENDER"), depsgraph.mode == "RENDER"
    known = _known.get(key)
    own = _curves_of(obj.data, None)
    evaluated = _evaluated(obj, depsgraph)
    shown = own
    if evaluated is not None:
        shown = _shown(obj, evaluated, own, model_to_world, final)
    if len(shown.offsets) < 2:
        return None
    if shown.matches(own):
        rest = _moved(own, _TO_HEAD @ np.array(_place_on_head(head, obj), np.float64))
        made = _of_rest(head, obj, rest, known, brief=not final and obj.mode != "OBJECT")
    else:
        made = _of_frame(head, shown, depsgraph, model_to_world, known, key[0])
    points = shown.points.astype(np.float32) if evaluated is not None else None
    before, shaped = made.shot.points, points is not None and follows_sliders(obj, final)
    if shaped != made.shot.shaped or points is None or before is None or not np.array_equal(points, before):
        made.shot = replace(made.shot, points=points, shaped=shaped) if points is not None or before is not None else made.shot
    _known[key] = made
    return made.shot


def _place_on_head(head: bpy.types.Object, obj: bpy.types.Object) -> Matrix:
    """The curves' axes to the head object's, [4, 4]; a hidden object has the world matrix of when it was hidden."""
    if obj.parent == head:
        return obj.matrix_parent_inverse @ obj.matrix_basis
    return head.matrix_world.inverted_safe() @ obj.matrix_world


def _evaluated(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object | None:
    """The evaluated object, None where it is hidden: a depsgraph has such objects too, without what their modifiers do."""
    found = depsgraph.objects.get(obj.name)
    if found is None or found.original != obj:  # several may have the name, of several libraries
        found = next((item for item in depsgraph.objects if item.original == obj), None)
    if found is None:  # perhaps it is there with the instance of a collection
        found = next((item.object for item in depsgraph.object_instances if item.object.original == obj), None)
    return found


def _shown(
    obj: bpy.types.Object, evaluated: bpy.types.Object, own: _Curves, model_to_world: np.ndarray, final: bool
) -> _Curves:
    """Evaluated curves in head space; as wide as the object's own where only sliders have changed that, for other engines."""
    if abs(np.linalg.det(model_to_world[:3, :3])) < _NO_SIZE:
        raise ShapeError("The head has no size; scale it up to see its curves.")
    to_head = np.linalg.inv(model_to_world) @ np.array(evaluated.matrix_world, np.float64)
    shown = _moved(_curves_of(evaluated.data, own), to_head)
    if follows_sliders(obj, final) and np.array_equal(shown.offsets, own.offsets):
        return replace(shown, radii=own.radii)
    return shown


def _of_rest(head: bpy.types.Object, obj: bpy.types.Object, rest: _Curves, known: _Known | None, brief: bool) -> _Known:
    """The groom of curves at rest on the head's own mesh; `brief`: that of before will do for other points."""
    vertices = resting_vertices(head)
    if known is not None and known.resting is not None and known.source.matches(rest):
        same = np.array_equal(known.source.points, rest.points) and np.array_equal(known.resting, vertices)
        if same or brief:
            return known
    return _Known(rest, vertices, _shot(obj.session_uid, _groom(head, rest, vertices)))


def _of_frame(
    head: bpy.types.Object, shown: _Curves, depsgraph: bpy.types.Depsgraph, model_to_world: np.ndarray, known: _Known | None,
    number: int,
) -> _Known:  # fmt: skip
    """The groom of curves that only the evaluated scene has, on the head as it is there."""
    evaluated = head.evaluated_get(depsgraph)
    vertices = _positions(evaluated.data.attributes, len(evaluated.data.vertices))
    if len(vertices) != len(head.data.vertices):
        raise ShapeError("The head's modifiers add or remove vertices; switch them off, or keep the number of curves.")
    to_head = np.linalg.inv(model_to_world) @ np.array(evaluated.matrix_world, np.float64)
    vertices = _transformed(vertices, to_head)
    if known is not None and known.frames is not None and known.source.matches(shown):
        groom = known.shot.groom
        if len(groom.points) == len(shown.points):
            away = np.abs(groom.posed(known.frames, vertices) - shown.points).max()
            if np.isfinite(away) and away < SAME_REST:
                return known
    groom = _groom(head, shown, vertices)
    model = load_head(AssetReference(head.grmm.head_name))
    frames = groom.frames(np.asarray(model.v_template, float), np.asarray(model.faces))
    return _Known(shown, None, _shot(number, groom), frames)


def _groom(head: bpy.types.Object, curves: _Curves, vertices: np.ndarray) -> Groom:
    model = load_head(AssetReference(head.grmm.head_name))
    groups = None if curves.parts is None else curves.parts.astype(int) - 1
    return groom_from_curves(
        model, vertices, curves.points, curves.offsets, curves.uv, curves.radii, groups, curves.tints
    )  # fmt: skip


def _shot(number: int, groom: Groom) -> StrandShot:
    digest = hashlib.blake2b(digest_size=12)
    own = () if groom.tints is None else (groom.tints,)
    for array in (groom.triangles, groom.weights, groom.offsets, groom.points, groom.widths, groom.groups, *own):
        digest.update(np.ascontiguousarray(array).tobytes())
    return StrandShot(f"curves {number}", digest.hexdigest(), groom)


def _curves_of(data: bpy.types.Curves, source: _Curves | None) -> _Curves:
    """Copy curves, without children; where geometry nodes dropped the roots' places, those of `source` hold for as many."""
    count, total = len(data.curves), len(data.points)
    offsets = np.zeros(count + 1, np.int32)
    if count:
        data.curve_offset_data.foreach_get("value", offsets)
    children = _attribute(data, CHILD, "INT", count, "value", 1)
    own = np.ones(count, bool) if children is None else children == 0
    of_points: np.ndarray | slice = slice(None) if own.all() else np.repeat(own, np.diff(offsets))
    if not own.all():
        offsets = np.concatenate([[0], np.cumsum(np.diff(offsets)[own])]).astype(np.int32)
    if offsets[-1] > MAX_POINTS:  # refused before anything is copied
        raise ShapeError(f"The curves have {offsets[-1]} points; use fewer hairs or points: at most {MAX_POINTS}.")
    points = _positions(data.attributes, total)[of_points]
    if not np.isfinite(points).all():
        raise ShapeError("The curves have values that are not finite; undo what made them, or delete these hairs.")

    def read(name: str, kind: str, rows: int, field_name: str, size: int, some: np.ndarray | slice) -> np.ndarray | None:
        values = _attribute(data, name, kind, rows, field_name, size)
        return None if values is None else values[some]

    uv, parts = read(UV_COORDINATE, "FLOAT2", count, "vector", 2, own), read(PART, "INT", count, "value", 1, own)
    if source is not None and len(source.offsets) == len(offsets):
        uv, parts = source.uv if uv is None else uv, source.parts if parts is None else parts
    radii = read("radius", "FLOAT", total, "value", 1, of_points)
    return _Curves(points, offsets, uv, radii, read(TINT, "FLOAT_VECTOR", total, "vector", 3, of_points), parts)


def _attribute(data: bpy.types.Curves, name: str, kind: str, count: int, field_name: str, size: int) -> np.ndarray | None:
    found = data.attributes.get(name)
    if found is None or found.data_type != kind or len(found.data) != count:
        return None
    values = np.empty(count * size, np.int32 if kind == "INT" else np.float32)
    found.data.foreach_get(field_name, values)
    return values.reshape(count, size) if size > 1 else values


def _positions(attributes: bpy.types.AttributeGroup, count: int) -> np.ndarray:
    points = np.zeros(3 * count, np.float32)
    if count:
        attributes["position"].data.foreach_get("vector", points)
    return points.reshape(-1, 3)


def resting_vertices(head: bpy.types.Object) -> np.ndarray:
    """The head's mesh without shape keys and pose, head space, metres, [V, 3]."""
    return _transformed(_positions(head.data.attributes, len(head.data.vertices)), _TO_HEAD)


def _moved(curves: _Curves, matrix: np.ndarray) -> _Curves:
    return replace(curves, points=_transformed(curves.points, matrix))


def _transformed(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]
