"""Panels that stand twice: in the sidebar's GRMM tab and in the object data tab, with one content."""

from __future__ import annotations

import bpy

from ..rig.avatar import Avatar, avatar_of
from ..width import is_narrow

CATEGORY = "GRMM"


class Content:
    """Content of a panel; where it stands is added by `twins`."""

    bl_label: str
    layout: bpy.types.UILayout


class AvatarPanel(Content):
    """Content about the selected avatar, head or armature."""

    avatar_only = True

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Show with an avatar selected."""
        return not cls.avatar_only or avatar_of(context.object) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = not is_narrow(context)
        avatar = avatar_of(context.object)
        if avatar is None:
            self.draw_without(layout, context)
        else:
            self.draw_avatar(layout, avatar, context)

    def draw_without(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw where no avatar is selected."""

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Draw for the selected avatar."""
        raise TypeError(f"{type(self).__name__} draws nothing")


def twins(content: type[Content], name: str, closed: bool, parent: str = "") -> tuple[type, type]:
    """Make the sidebar's and the data tab's panel of one content.

    Args:
        content: Draws them; may have `bl_label`, `poll`, `draw`, and `draw_header_preset`.
        name: End of the panels' names.
        closed: The sidebar's is closed at first; the data tab's always is.
        parent: End of the names of the panels that they stand in.
    """
    sidebar = {"bl_space_type": "VIEW_3D", "bl_region_type": "UI", "bl_category": CATEGORY}
    data_tab = {"bl_space_type": "PROPERTIES", "bl_region_type": "WINDOW", "bl_context": "data", "avatar_only": True}
    made = []
    for prefix, title, is_closed, place in (("GRMM_PT_", "", closed, sidebar), ("GRMM_PT_data_", "GRMM ", True, data_tab)):
        members = {**place, "bl_options": {"DEFAULT_CLOSED"} if is_closed else set(), "__doc__": content.__doc__}
        members["bl_label"] = content.bl_label if parent else title + content.bl_label
        if parent:
            members["bl_parent_id"] = prefix + parent
        made.append(type(prefix + name, (content, bpy.types.Panel), members))
    return made[0], made[1]
