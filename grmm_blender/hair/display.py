"""What solid viewports show of curves that are an avatar's hair: Blender's curves while they are edited, else splats alone.

Who shows them otherwise by hand keeps that until the curves are edited the next time.
"""

from __future__ import annotations

import bpy

AS_SPLATS, AS_CURVES = "WIRE", "TEXTURED"  # display types: Blender draws no surface of the first, so that splats are not hidden

_edited: set[int] = set()


def follow_mode(obj: bpy.types.Object) -> None:
    """Show curves as what they are from now on, after they went into a mode that edits them, or left it."""
    editing = obj.mode != "OBJECT"
    if editing == (obj.session_uid in _edited):
        return
    _edited.symmetric_difference_update({obj.session_uid})
    obj.display_type = AS_CURVES if editing else AS_SPLATS


def forget() -> None:
    """Another file is opened."""
    _edited.clear()
