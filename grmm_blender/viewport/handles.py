"""Handles on the face of the active avatar: points that light up under the mouse and are dragged (`grmm.drag_face`).

They are Blender's gizmos, drawn over the splats, at landmarks of the evaluated mesh, so that they follow every expression.
"""

from __future__ import annotations

import math
from typing import ClassVar

import blf
import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix, Vector

from ...grmm_core.avatar import AssetReference
from ...grmm_core.controls.handles import HANDLES, Handle
from ...grmm_core.controls.table import REGIONS
from ...grmm_core.errors import GrmmError
from ..rig.avatar import Avatar, active_object, avatar_of
from ..rig.identity import load_head

OPERATOR = "grmm.drag_face"
_SIZE, _REACH, _TEXT_SIZE = 4.5, 9.0, 12.0  # pixels at interface scale 1: radius, how near the mouse is, text
_CORNERS = 24
_EDGE_COLOR, _TEXT_COLOR = (0.0, 0.0, 0.0, 0.8), (1.0, 1.0, 1.0, 1.0)
_COLORS = ((0.95, 0.75, 0.2), (0.3, 0.75, 0.95), (0.95, 0.45, 0.4), (0.55, 0.85, 0.4), (0.8, 0.55, 0.95))
_AXIS_MARKS = (36, 45, 33, 27)  # outer corners of the right and left eye, base and root of the nose
_SIDE_ON = 0.25  # of the other axis' length on the screen: a direction shorter than this points at the viewer
_TURNED_AWAY = 0.1  # cosine: the face is seen from behind


class FaceView:
    """Where the handles of an avatar are on a region, and which way the face's own axes run there."""

    def __init__(self, avatar: Avatar, context: bpy.types.Context) -> None:
        """Look at the evaluated mesh. Raises `GrmmError` where the head has no landmarks, or lost vertices to a modifier."""
        self._region, self._view = context.region, context.region_data
        head = load_head(AssetReference(avatar.object.grmm.head_name))
        posed = avatar.object.evaluated_get(context.evaluated_depsgraph_get())
        positions = np.empty((len(posed.data.vertices), 3), np.float32)
        posed.data.attributes["position"].data.foreach_get("vector", positions.reshape(-1))
        if len(positions) < head.vertex_count:
            raise GrmmError("A modifier takes vertices off the head; the face has no handles.")
        world = np.array(posed.matrix_world, np.float64)
        self._marks = head.landmark_positions(positions[: head.vertex_count]) @ world[:3, :3].T + world[:3, 3]
        right, left, base, root = (Vector(self._marks[mark]) for mark in _AXIS_MARKS)
        self._left, self._up = (left - right).normalized(), (root - base).normalized()

    def point(self, handle: Handle) -> Vector:
        """Return where a handle is in the world."""
        return Vector(self._marks[list(handle.landmarks)].mean(0)) + self._up * handle.offset

    def place(self, handle: Handle) -> Vector | None:
        """Return where it is on the region, pixels; None behind the viewer or the head."""
        point, view = self.point(handle), self._view.view_matrix
        towards = -(view @ point).normalized() if self._view.is_perspective else Vector((0.0, 0.0, 1.0))
        forward = view.to_3x3() @ self._left.cross(self._up)
        return location_3d_to_region_2d(self._region, self._view, point) if forward.dot(towards) > _TURNED_AWAY else None

    def moved(self, handle: Handle, pixels: Vector) -> tuple[float, float]:
        """Return how far a drag over the region goes to the subject's left and upwards, metres."""
        point, step = self.point(handle), 0.01
        start, *ends = (
            location_3d_to_region_2d(self._region, self._view, point + way * step) for way in (Vector(), self._left, self._up)
        )
        if start is None or None in ends:
            return 0.0, 0.0
        axes = [(end - start) / step for end in ends]  # pixels a metre
        longest = max(axis.length for axis in axes)
        if not longest:
            return 0.0, 0.0
        sideways, up = (pixels.dot(axis.normalized()) / longest if axis.length > _SIDE_ON * longest else 0.0 for axis in axes)
        return sideways, up


class GRMM_GT_handle(bpy.types.Gizmo):
    """One handle: a disc, larger and with its name under the mouse."""

    bl_idname = "GRMM_GT_handle"
    __slots__ = ("label",)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw it where `matrix_basis` has it."""
        scale = context.preferences.system.ui_scale or 1.0
        radius = _SIZE * scale * (1.4 if self.is_highlight or self.is_modal else 1.0)
        corners = [(math.cos(2 * math.pi * k / _CORNERS), math.sin(2 * math.pi * k / _CORNERS)) for k in range(_CORNERS)]
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        batch = batch_for_shader(shader, "TRI_FAN", {"pos": corners})
        place = self.matrix_basis.translation
        gpu.state.blend_set("ALPHA")
        for size, color in ((radius + 1.5 * scale, _EDGE_COLOR), (radius, (*self.color, self.alpha))):
            with gpu.matrix.push_pop():
                gpu.matrix.multiply_matrix(Matrix.Translation(place) @ Matrix.Scale(size, 4))
                shader.uniform_float("color", color)
                batch.draw(shader)
        gpu.state.blend_set("NONE")
        if self.is_highlight and not self.is_modal:
            blf.size(0, _TEXT_SIZE * scale)
            blf.color(0, *_TEXT_COLOR)
            blf.position(0, place.x + 2 * radius, place.y + radius, 0)
            blf.draw(0, self.label)

    def test_select(self, context: bpy.types.Context, location: tuple[int, int]) -> int:
        """Whether the mouse is on it."""
        near = _REACH * (context.preferences.system.ui_scale or 1.0)
        return 0 if (Vector(location) - self.matrix_basis.translation.xy).length < near else -1


class GRMM_GGT_face(bpy.types.GizmoGroup):
    """The handles of the active avatar."""

    bl_idname = "GRMM_GGT_face"
    bl_label = "GRMM Face Handles"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options: ClassVar[set[str]] = {"PERSISTENT", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With an avatar that is posed, where the handles are switched on."""
        obj = active_object(context)
        if not context.scene.grmm_viewport.use_handles or obj is None or obj.mode not in ("OBJECT", "POSE"):
            return False
        return avatar_of(obj) is not None

    def setup(self, context: bpy.types.Context) -> None:
        """Make a gizmo for each handle."""
        regions = list(REGIONS)
        self.shown = {}
        for handle in HANDLES.values():
            gizmo = self.gizmos.new(GRMM_GT_handle.bl_idname)
            gizmo.label = handle.label
            gizmo.color, gizmo.alpha = _COLORS[regions.index(handle.region) % len(_COLORS)], 0.9
            gizmo.target_set_operator(OPERATOR).handle = handle.name
            self.shown[handle.name] = gizmo

    def draw_prepare(self, context: bpy.types.Context) -> None:
        """Put them where the face is now."""
        places = self._places(context)
        for name, gizmo in self.shown.items():
            gizmo.hide = name not in places
            if name in places:
                gizmo.matrix_basis = Matrix.Translation((*places[name], 0.0))

    def _places(self, context: bpy.types.Context) -> dict[str, Vector]:
        """Where each handle is on the region, of those that the avatar has and that can be seen."""
        avatar = avatar_of(active_object(context))
        if avatar is None:
            return {}
        try:
            face = FaceView(avatar, context)
        except GrmmError:
            return {}
        usable = (handle for handle in HANDLES.values() if all(name in avatar.object for name in handle.expressions))
        return {handle.name: place for handle in usable if (place := face.place(handle)) is not None}


CLASSES = (GRMM_GT_handle, GRMM_GGT_face)
