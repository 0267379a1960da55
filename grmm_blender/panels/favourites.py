"""Controls that a user has given a star: kept in the preferences, so that they are there in every file."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ...grmm_core.controls.table import CONTROLS
from .. import preferences
from ..declare import Operator, text


def names() -> list[str]:
    """Return the controls with a star, in the order of the table."""
    chosen = preferences.get().favourites.split()
    return [name for name in CONTROLS if name in chosen]


class GRMM_OT_favourite(Operator):
    """Show this control among the favourites as well, or no longer."""

    bl_label = "Favourite"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    control: text("Control", "Name of the control", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where there are preferences to keep it in."""
        if not preferences.are_kept():
            cls.poll_message_set("Favourites are kept in the preferences; enable the extension there")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Change the list."""
        chosen = set(names()) ^ {self.control}
        preferences.get().favourites = " ".join(name for name in CONTROLS if name in chosen)
        context.preferences.is_dirty = True  # saved with them on exit, where that is on
        return {"FINISHED"}
