"""Bones of rigs that are being posed, over the splats and over the mesh.

Blender draws its bones before the splats, which then hide them, and inside the mesh. Nothing is drawn outside of pose mode, so
that no bones stand in a face that is only looked at.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import gpu
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from .. import compat
from ..rig.avatar import avatar_of

_WIDTH, _EDGE = 4.0, 2.0  # pixels at interface scale 1, and how much the dark line behind is wider
_EDGE_COLOR = (0.0, 0.0, 0.0, 1.0)

Line = tuple[Vector, Vector, tuple[float, float, float, float]]


def draw_bones(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """Draw the visible bones of avatars' rigs in pose mode; the view's matrices are set."""
    overlay = context.space_data.overlay
    if not (overlay.show_overlays and overlay.show_bones):
        return
    lines = list(posed_bones(context, depsgraph))
    if not lines:
        return
    positions = [end for start, tip, _ in lines for end in (start, tip)]
    colors = [color for *_, color in lines for _ in range(2)]
    shader = gpu.shader.from_builtin("POLYLINE_FLAT_COLOR")
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    scale = context.preferences.system.ui_scale or 1.0
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("ALPHA")
    for width, tints in ((_WIDTH + _EDGE, [_EDGE_COLOR] * len(colors)), (_WIDTH, colors)):
        shader.uniform_float("lineWidth", width * scale)
        batch_for_shader(shader, "LINES", {"pos": positions, "color": tints}).draw(shader)
    gpu.state.blend_set("NONE")


def posed_bones(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> Iterator[Line]:
    """Yield the lines of the visible bones of avatars' rigs in pose mode: both ends in the world, color of their selection."""
    theme = context.preferences.themes[0]
    for obj in context.view_layer.objects:
        if obj.type != "ARMATURE" or obj.mode != "POSE" or not obj.visible_get() or avatar_of(obj) is None:
            continue
        posed = obj.evaluated_get(depsgraph)
        for bone in obj.pose.bones:
            hidden, selected = compat.bone_state(bone)
            if hidden or not any(collection.is_visible_effectively for collection in bone.bone.collections):
                continue
            state = "active" if selected and obj.data.bones.active == bone.bone else "select" if selected else "normal"
            color = _color(theme, bone.bone.color.palette, state)
            for start, tip in _segments(posed.pose.bones[bone.name], bone.custom_shape):
                yield posed.matrix_world @ start, posed.matrix_world @ tip, color


def _segments(bone: bpy.types.PoseBone, shape: bpy.types.Object | None) -> list[tuple[Vector, Vector]]:
    """The lines of a bone in its armature: those of its custom shape, where it has one."""
    if shape is None or shape.type != "MESH":
        return [(bone.head, bone.tail)]
    size = bone.custom_shape_scale_xyz * (bone.length if bone.use_custom_shape_bone_size else 1.0)
    places = [bone.matrix @ (vertex.co * size) for vertex in shape.data.vertices]
    return [(places[first], places[second]) for first, second in (edge.vertices for edge in shape.data.edges)]


def _color(theme: bpy.types.Theme, palette: str, state: str) -> tuple[float, float, float, float]:
    if palette.startswith("THEME"):
        return (*getattr(theme.bone_color_sets[int(palette.removeprefix("THEME")) - 1], state), 1.0)
    view = theme.view_3d
    return (*{"normal": view.bone_solid, "select": view.bone_pose, "active": view.bone_pose_active}[state], 1.0)
