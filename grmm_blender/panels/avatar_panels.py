"""The avatar's panels: who it is, its sliders by region, pose, learned detail, and what runs the model.

Each panel stands in the sidebar's GRMM tab and, as a twin, in the object data tab. They draw the custom properties of the
selected avatar (see `rig.definitions`) and follow the selection: head or armature.
"""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..avatar import Avatar, avatar_of
from ..rig.definitions import ARRAY_NAMES, CONTROL_JOINTS, REGIONS, SHAPE, STRENGTH, Z_EXP, Z_ID, label, mirrored, property_path
from ..session_host import runtime_status

CATEGORY = "GRMM"
LEADING_COMPONENTS = 8  # of an array; the rest is reached through the object's custom properties
_ROTATION_NAMES = ("Pitch", "Yaw", "Roll")


class _AvatarPanel:
    """Content of a panel; where it stands is added by `_twins`."""

    avatar_only = True

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Show with an avatar selected."""
        return not cls.avatar_only or avatar_of(context.object) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        avatar = avatar_of(context.object)
        if avatar is None:
            self.draw_without(layout)
        else:
            self.draw_avatar(layout, avatar, context)

    def draw_without(self, layout: bpy.types.UILayout) -> None:
        """Draw where no avatar is selected."""

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Draw for the selected avatar."""
        raise TypeError(f"{type(self).__name__} draws nothing")


class _Avatar(_AvatarPanel):
    """Who is shown and what runs the model."""

    bl_label = "Avatar"
    avatar_only = False

    def draw_without(self, layout: bpy.types.UILayout) -> None:
        """Offer to add one."""
        column = layout.column(align=True)
        column.operator("grmm.add_head", icon="ADD").person = "DEFAULT"
        column.operator("grmm.add_head", text="Add Random Person", icon="COMMUNITY").person = "RANDOM"
        column.operator("grmm.open_avatar", text="Open Avatar...", icon="FILE_FOLDER")
        _draw_runtime(layout)

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Source, switches, engine."""
        settings = avatar.object.grmm
        layout.prop(avatar.object, "name", text="Name")
        layout.prop(settings, "source")
        layout.prop(settings, "live_detail")
        row = layout.row()
        row.active = settings.live_detail
        row.prop(settings, "detail_in_playback")
        layout.operator("grmm.import_performance", icon="ANIM_DATA")
        if context.engine != "GRMM":
            layout.prop(context.scene.render, "engine", text="Render with")
        _draw_runtime(layout)


class _Expression(_AvatarPanel):
    """The aligned expressions by region."""

    bl_label = "Expression"

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """One box for each region; the two sides of an expression stand in one row."""
        head = avatar.object
        layout.use_property_split = False
        for region, names in REGIONS.items():
            box = layout.box().column(align=True)
            box.label(text=region)
            drawn: set[str] = set()
            for name in names:
                if name in drawn or name not in head:
                    continue
                partner = mirrored(name)
                # The subject's right side stands on the left, as it does on the face that looks at the animator.
                pair = [n for n in dict.fromkeys((partner, name)) if n in names] if name.endswith("Left") else [name]
                row = box.row(align=True)
                for member in pair:
                    row.prop(head, property_path(member), text=label(member), slider=True)
                drawn.update(pair)


class _Pose(_AvatarPanel):
    """Neck, jaw and eyes."""

    bl_label = "Pose"

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """The bones' rotations, so that panel and viewport edit the same thing."""
        if avatar.armature is None:
            layout.label(text="The armature is missing; add the head again", icon="ERROR")
            return
        for joint in CONTROL_JOINTS:
            bone = avatar.armature.pose.bones.get(joint)
            if bone is None:
                continue
            column = layout.column(align=True)
            for axis, name in enumerate(_ROTATION_NAMES[: 2 if joint.endswith("eye") else 3]):
                text = f"{label(joint.replace('_', ' ').title().replace(' ', ''))} {name}"
                column.prop(bone, "rotation_euler", index=axis, text=text)


class _Identity(_AvatarPanel):
    """Shape and residual identity."""

    bl_label = "Identity"
    arrays: ClassVar[tuple[str, ...]] = (SHAPE, Z_ID)

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """The leading components."""
        for name in self.arrays:
            _draw_array(layout, avatar, name)


class _Residual(_Identity):
    """The learned detail."""

    bl_label = "Learned Detail"
    arrays = (Z_EXP,)

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Strength and the residual expression code."""
        if STRENGTH in avatar.object:
            layout.prop(avatar.object, property_path(STRENGTH), text="Strength", slider=True)
        super().draw_avatar(layout, avatar, context)


def _draw_array(layout: bpy.types.UILayout, avatar: Avatar, name: str) -> None:
    if name not in ARRAY_NAMES or name not in avatar.object:
        return
    column = layout.column(align=True)
    column.label(text={SHAPE: "Shape", Z_ID: "Residual Identity", Z_EXP: "Residual Expression"}[name])
    for index in range(min(LEADING_COMPONENTS, len(avatar.object[name]))):
        column.prop(avatar.object, property_path(name), index=index, text=f"{index}", slider=True)


def _draw_runtime(layout: bpy.types.UILayout) -> None:
    status = runtime_status()
    row = layout.row()
    row.label(text=status.message, icon="CHECKMARK" if status.available else "INFO")


def _twins(content: type[_AvatarPanel], name: str, closed: bool) -> tuple[type, type]:
    """Make the sidebar's and the data tab's panel of one content."""
    options = {"DEFAULT_CLOSED"} if closed else set()
    sidebar = type(
        f"GRMM_PT_{name}",
        (content, bpy.types.Panel),
        {
            "bl_label": content.bl_label, "bl_space_type": "VIEW_3D", "bl_region_type": "UI", "bl_category": CATEGORY,
            "bl_options": options, "__doc__": content.__doc__,
        },
    )  # fmt: skip
    data_tab = type(
        f"GRMM_PT_data_{name}",
        (content, bpy.types.Panel),
        {
            "bl_label": f"GRMM {content.bl_label}", "bl_space_type": "PROPERTIES", "bl_region_type": "WINDOW",
            "bl_context": "data", "bl_options": {"DEFAULT_CLOSED"}, "avatar_only": True, "__doc__": content.__doc__,
        },
    )  # fmt: skip
    return sidebar, data_tab


CLASSES = tuple(
    panel
    for content, name, closed in (
        (_Avatar, "avatar", False),
        (_Expression, "expression", False),
        (_Pose, "pose", True),
        (_Identity, "identity", True),
        (_Residual, "residual", True),
    )
    for panel in _twins(content, name, closed)
)
