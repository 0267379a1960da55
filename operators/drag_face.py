"""Drag a handle of the face: what `viewport.handles` draws ends here."""

from __future__ import annotations

from typing import ClassVar

import bpy
from mathutils import Vector

from ..grmm_blender.declare import Operator, choice
from ..grmm_blender.viewport.handles import FaceView
from ..grmm_core.controls.handles import HANDLES, Handle
from ..grmm_core.controls.table import CONTROLS
from ..grmm_core.errors import GrmmError
from .common import Result, active_avatar
from .edit import Edit

_PRECISE = 0.1  # of the mouse's way, with Shift
_ARROWS = {"up": "up", "down": "down", "left": "to the subject's left", "right": "to the subject's right"}


class GRMM_OT_drag_face(Edit, Operator):
    """Drag a point of the face of the active avatar; Ctrl for both sides, Shift for precision."""

    bl_label = "Drag Face"
    bl_options: ClassVar[set[str]] = {"UNDO", "GRAB_CURSOR", "BLOCKING", "INTERNAL"}

    handle: choice(
        "Handle",
        "Which point of the face",
        *((handle.name, handle.label, f"{handle.label}, {handle.region.lower()}") for handle in HANDLES.values()),
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Name the point, its region, and what each direction does."""
        handle = HANDLES[properties.handle]
        ways = "; ".join(f"{_ARROWS[way]}: {_labels(names)}" for way, names in handle.moves.items())
        return f"{handle.label} ({handle.region}). Drag {ways}. Ctrl for both sides, Shift for precision"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Begin; nothing has changed yet."""
        avatar = active_avatar(context)
        if context.region_data is None:
            return {"CANCELLED"}
        try:
            self._face = FaceView(avatar, context)
        except GrmmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        handle = HANDLES[self.handle]
        self._start = {name: float(avatar.object[name]) for name in (*handle.expressions, *HANDLES[handle.partner].expressions)}
        self._mouse, self._way = Vector((event.mouse_x, event.mouse_y)), Vector((0.0, 0.0))
        self._names: list[str] = []
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Follow the mouse until its button is let go; Escape or the right button puts everything back."""
        avatar = active_avatar(context)  # the one of `invoke`: nothing else can be chosen meanwhile
        if event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self._set(avatar.object, {})
            avatar.tag_edited()
            return self._end(context, {"CANCELLED"})
        if event.type == "LEFTMOUSE" and event.value == "RELEASE":
            return self._end(context, self.finish(context, avatar, self._names) if self._names else {"CANCELLED"})
        if event.type == "MOUSEMOVE":
            mouse = Vector((event.mouse_x, event.mouse_y))
            self._way += (mouse - self._mouse) * (_PRECISE if event.shift else 1.0)
            self._mouse = mouse
            handle = HANDLES[self.handle]
            values = dragged(handle, self._start, *self._face.moved(handle, self._way), both=event.ctrl)
            self._set(avatar.object, values)
            avatar.tag_edited()
            shown = ", ".join(f"{CONTROLS[name].label} {value:.2f}" for name, value in values.items())
            context.area.header_text_set(f"{shown}   (Ctrl: both sides, Shift: precise, Esc: cancel)")
        return {"RUNNING_MODAL"}

    def _set(self, head: bpy.types.Object, values: dict[str, float]) -> None:
        """Write what a drag gives, and what the drag began with to everything else that it touched."""
        for name, start in self._start.items():
            if head[name] != values.get(name, start):
                head[name] = values.get(name, start)
        self._names = [name for name, value in values.items() if value != self._start[name]]

    def _end(self, context: bpy.types.Context, result: Result) -> Result:
        context.area.header_text_set(None)
        return result


def dragged(handle: Handle, start: dict[str, float], sideways: float, up: float, both: bool) -> dict[str, float]:
    """Return the weights that a drag gives, on both sides of the face where that is wanted; arguments as `Handle.weights`."""
    values, partner = handle.weights(start, sideways, up), HANDLES[handle.partner]
    if both and set(partner.expressions) != set(handle.expressions):  # those that move both eyes do it anyway
        values = {**partner.weights(start, -sideways, up), **values}
    return values


def _labels(names: tuple[str, ...]) -> str:
    return " and ".join(CONTROLS[name].label for name in names)


CLASSES = (GRMM_OT_drag_face,)
