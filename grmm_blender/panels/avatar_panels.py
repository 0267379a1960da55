"""The avatar's panels: who it is, one for each section of the core's table of controls, and what runs the model.

Each panel stands in the sidebar's GRMM tab and, as a twin, in the object data tab. They draw the custom properties of the
selected avatar and follow the selection: head or armature. A section that has no class here gets its sliders and a reset.
"""

from __future__ import annotations

import bpy

from ...grmm_core.controls.control import Control, Section
from ...grmm_core.controls.table import CONTROLS, JOINTS, SECTIONS, SHAPE, Z_EXP, Z_ID
from ..rig import live
from ..rig.avatar import Avatar, avatar_of
from ..rig.components import components
from ..rig.custom_properties import property_path
from ..rig.saved_codes import SLOTS, blend_control, saved_slots
from ..session_host import runtime_status
from .sliders import draw_expressions, draw_sliders
from .width import draw_text, is_narrow

CATEGORY = "GRMM"
ALL = "ALL"  # of the operators' regions
LEADING_COMPONENTS = 8  # of an array; the rest is reached through the object's custom properties


class _AvatarPanel:
    """Content of a panel; where it stands is added by `_twins`."""

    avatar_only = True
    bl_label: str
    layout: bpy.types.UILayout

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


class _Avatar(_AvatarPanel):
    """Who is shown and what runs the model."""

    bl_label = "Avatar"
    avatar_only = False

    def draw_without(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Offer to add one."""
        column = layout.column(align=True)
        column.operator("grmm.add_head", icon="ADD").person = "DEFAULT"
        column.operator("grmm.add_head", text="Add Random Person", icon="COMMUNITY").person = "RANDOM"
        column.operator("grmm.open_avatar", text="Open Avatar...", icon="FILE_FOLDER")
        column.operator("grmm.add_flame_head", text="Add FLAME Head...", icon="MONKEY")
        _draw_runtime(layout, context)

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Source, switches, engine."""
        settings = avatar.object.grmm
        layout.prop(avatar.object, "name", text="Name")
        layout.prop(settings, "source")
        if avatar.has_network:
            layout.prop(settings, "live_detail")
            row = layout.row()
            row.active = settings.live_detail
            row.prop(settings, "detail_in_playback")
        wrong = avatar.missing_file or live.state_of(avatar).message
        problem = wrong or live.limitation(avatar)
        if problem:
            draw_text(layout, problem, context, icon="ERROR")
            if wrong and avatar.has_network:
                layout.operator("grmm.relink_avatar", text="Relink Avatar...", icon="FILE_FOLDER")
            if avatar.mesh_owner not in (None, avatar.object):
                layout.operator("grmm.make_independent")
        layout.operator("grmm.import_performance", icon="ANIM_DATA")
        if context.engine != "GRMM":
            layout.prop(context.scene.render, "engine", text="Engine")
        _draw_runtime(layout, context)


class _Section(_AvatarPanel):
    """The controls of a section: a reset, and its sliders."""

    section: Section

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """What the section has of its own, then its sliders."""
        self.draw_own(layout, avatar, context)
        draw_sliders(layout, avatar.object, self.section.key)

    def draw_own(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Edits of the whole section."""
        self.draw_reset(layout.row(align=True))

    def draw_reset(self, row: bpy.types.UILayout) -> None:
        """The button that puts the section at rest."""
        row.operator("grmm.reset", text="Reset", icon="LOOP_BACK").what = self.section.key


class _Expression(_Section):
    """The named expressions by region."""

    def draw_own(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """One box for each region; the two sides of an expression stand in one row where there is room for it."""
        layout.use_property_split = False
        narrow = is_narrow(context)
        _draw_edits(layout, ALL, narrow)
        draw_expressions(layout, avatar.object, narrow, lambda heading, region: _draw_edits(heading, region, narrow))


class _Pose(_Section):
    """Neck, jaw and eyes."""

    def draw_own(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """The bones' rotations, so that panel and viewport edit the same thing."""
        if avatar.armature is None:
            layout.label(text="The armature is missing; add the head again", icon="ERROR")
            return
        row = layout.row(align=True)
        self.draw_reset(row)
        row.operator("grmm.calibrate_neutral", text="Neutral", icon="ARMATURE_DATA")
        for joint in JOINTS:
            bone = avatar.armature.pose.bones.get(joint.name)
            if bone is None or not joint.axes:
                continue
            column = layout.column(align=True)
            for axis, name in enumerate(joint.axes):
                column.prop(bone, "rotation_euler", index=axis, text=f"{joint.label} {name}")


class _Identity(_Section):
    """Shape and residual identity."""

    def draw_own(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Random person, the leading components, saved persons."""
        row = layout.row(align=True)
        row.operator("grmm.random_identity", text="Random", icon="COMMUNITY")
        self.draw_reset(row)
        _draw_array(layout, avatar, CONTROLS[SHAPE])
        _draw_code(layout, avatar, CONTROLS[Z_ID])


class _Residual(_Section):
    """The learned detail."""

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Strength, the residual expression code, saved codes."""
        if Z_EXP not in avatar.object:
            layout.label(text="No network draws this head", icon="INFO")
            return
        draw_sliders(layout, avatar.object, self.section.key)
        row = layout.row(align=True)
        row.operator("grmm.random_detail", text="Random", icon="MOD_NOISE")
        self.draw_reset(row)
        _draw_code(layout, avatar, CONTROLS[Z_EXP])


def _draw_edits(layout: bpy.types.UILayout, region: str, narrow: bool) -> None:
    """Random, flip, copy to either side and reset for the expressions of a region; words for all, icons for one."""
    column = layout.column(align=True)
    row = column.row(align=True)
    for operator, text, icon, direction in (
        ("grmm.random_expression", "Random", "MOD_NOISE", ""),
        ("grmm.reset", "Reset", "LOOP_BACK", ""),
        ("grmm.mirror", "Flip", "MOD_MIRROR", "SWAP"),
        ("grmm.mirror", "L to R", "TRIA_LEFT", "LEFT"),  # the subject's left is on the right of the picture
        ("grmm.mirror", "R to L", "TRIA_RIGHT", "RIGHT"),
    ):
        if narrow and region == ALL and direction == "SWAP":
            row = column.row(align=True)
        options = row.operator(operator, text=text if region == ALL else "", icon=icon)
        options.region = region
        if direction:
            options.direction = direction
        if operator == "grmm.reset":
            options.what = "EXPRESSION"


def _draw_array(layout: bpy.types.UILayout, avatar: Avatar, control: Control, labels: dict[int, str] | None = None) -> None:
    """The leading components of an array; `labels` says which, and in what words."""
    if control.name not in avatar.object:
        return
    column = layout.column(align=True)
    column.label(text=control.label)
    if labels is None:
        labels = {index: "" for index in range(min(LEADING_COMPONENTS, len(avatar.object[control.name])))}
    for index, words in labels.items():
        column.prop(avatar.object, property_path(control.name), index=index, text=f"{index} {words}".strip(), slider=True)


def _draw_code(layout: bpy.types.UILayout, avatar: Avatar, control: Control) -> None:
    """A residual code: its components that are seen most, by what they do, and the blend of saved states."""
    head, name = avatar.object, control.name
    if name not in head:
        return
    leading = components(name, len(head[name]))[:LEADING_COMPONENTS]
    _draw_array(layout, avatar, control, {component.index: component.label for component in leading})
    column = layout.column(align=True)
    saved = saved_slots(head, name)
    row = column.row(align=True)
    for slot in SLOTS:
        options = row.operator("grmm.save_code", text=f"{'Replace' if slot in saved else 'Save'} {slot.upper()}")
        options.code, options.slot = name, slot.upper()
    if len(saved) == len(SLOTS):
        blend = blend_control(name)
        column.prop(head, property_path(blend.name), text=blend.label, slider=True)
        column.operator("grmm.apply_blend").code = name


def _draw_runtime(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    status = runtime_status()
    draw_text(layout, status.message, context, icon="CHECKMARK" if status.available else "INFO")


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


def _panels_of(section: Section) -> tuple[type, type]:
    """The panels of a section of controls."""
    content, name, closed = _SECTIONS.get(section.key, (_Section, section.key.lower(), True))
    members = {"bl_label": section.label, "section": section, "__doc__": content.__doc__}
    return _twins(type(content.__name__, (content,), members), name, closed)


_SECTIONS: dict[str, tuple[type[_Section], str, bool]] = {
    "EXPRESSION": (_Expression, "expression", False),
    "POSE": (_Pose, "pose", True),
    "IDENTITY": (_Identity, "identity", True),
    "DETAIL": (_Residual, "residual", True),
}  # content, end of the panel's name, closed at first
CLASSES = (*_twins(_Avatar, "avatar", False), *(panel for section in SECTIONS for panel in _panels_of(section)))
