"""The avatar's panels: who it is, one for each section of the core's table of controls, and what runs the model.

They draw the custom properties of the selected avatar and follow the selection: head or armature. A section that has no class
here gets its sliders and a reset; the expressions have a module of their own.
"""

from __future__ import annotations

import bpy

from ...grmm_core.avatar import AssetReference
from ...grmm_core.controls.control import Control, Section
from ...grmm_core.controls.table import CONTROLS, JOINTS, SECTIONS, SHAPE, Z_EXP, Z_ID
from ...grmm_core.errors import GrmmError
from ..rig import live
from ..rig.avatar import Avatar
from ..rig.components import components, shape_labels
from ..rig.custom_properties import property_path
from ..rig.identity import load_head
from ..rig.saved_codes import SLOTS, blend_control, saved_slots
from ..session_host import runtime_status
from ..width import draw_text
from .sliders import draw_controls, draw_named, draw_sliders
from .twins import AvatarPanel, twins

LEADING_COMPONENTS = 8  # of an array; the rest is reached through the object's custom properties
FINE_DETAIL = "Fine Detail"  # a component that is seen in the Gaussians only


class _Avatar(AvatarPanel):
    """Who is shown and what runs the model."""

    bl_label = "Avatar"
    avatar_only = False

    def draw_without(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Offer to add one."""
        layout.label(text="Add a head:")
        layout.column(align=True).menu_contents("GRMM_MT_add")
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
            layout.prop(settings, "wrinkles", slider=True)
        # what no runtime draws is no fault of the file: the sentence below says what to do
        wrong = avatar.missing_file or (live.state_of(avatar).message if runtime_status().available else "")
        problem = wrong or live.limitation(avatar)
        if problem:
            draw_text(layout, problem, context, icon="ERROR")
            if wrong and avatar.has_network:
                layout.operator("grmm.relink_avatar", text="Relink Avatar...", icon="FILE_FOLDER")
            if avatar.mesh_owner not in (None, avatar.object):
                layout.operator("grmm.make_independent")
        layout.operator("grmm.import_performance", icon="ANIM_DATA")
        layout.prop(context.scene.render, "engine", text="Engine")
        _draw_runtime(layout, context)


class _Section(AvatarPanel):
    """The controls of a section: a reset, and its sliders."""

    section: Section

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """What the section has of its own, then its sliders."""
        self.draw_own(layout, avatar, context)
        draw_sliders(layout, avatar, self.section.key, context)

    def draw_own(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Edits of the whole section."""
        self.draw_reset(layout.row(align=True))

    def draw_reset(self, row: bpy.types.UILayout) -> None:
        """The button that puts the section at rest."""
        row.operator("grmm.reset", text="Reset", icon="LOOP_BACK").what = self.section.key


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
        draw_controls(layout, avatar, [joint.name for joint in JOINTS if joint.axes], context)


class _Identity(_Section):
    """Shape and residual identity."""

    def draw_own(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Random person, the leading components, saved persons."""
        row = layout.row(align=True)
        row.operator("grmm.random_identity", text="Random", icon="COMMUNITY")
        self.draw_reset(row)
        _draw_array(layout, avatar, CONTROLS[SHAPE], _shape_labels(avatar))
        _draw_code(layout, avatar, CONTROLS[Z_ID])


class _Residual(_Section):
    """The learned detail."""

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Strength, the residual expression code, saved codes."""
        if Z_EXP not in avatar.object:
            layout.label(text="No network draws this head", icon="INFO")
            return
        draw_sliders(layout, avatar, self.section.key, context)
        row = layout.row(align=True)
        row.operator("grmm.random_detail", text="Random", icon="MOD_NOISE")
        self.draw_reset(row)
        _draw_code(layout, avatar, CONTROLS[Z_EXP])


def _draw_array(layout: bpy.types.UILayout, avatar: Avatar, control: Control, labels: dict[int, str]) -> None:
    """Some components of an array; `labels` says which, and what they do. Those that have no name of their own are counted."""
    if control.name not in avatar.object:
        return
    layout.label(text=control.label)
    column = layout.column(align=True)
    words = list(labels.values())
    for index, label in labels.items():
        text = label if label and words.count(label) == 1 else f"{label or FINE_DETAIL} {index}"
        draw_named(column, text, avatar.object, property_path(control.name), index)


def _shape_labels(avatar: Avatar) -> dict[int, str]:
    count = min(LEADING_COMPONENTS, len(avatar.object[SHAPE]))
    try:
        return dict(enumerate(shape_labels(load_head(AssetReference(avatar.object.grmm.head_name)), count)))
    except GrmmError:  # the rig says so itself
        return dict.fromkeys(range(count), "Component")


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


def _panels_of(section: Section) -> tuple[type, type]:
    """The panels of a section of controls."""
    content, name, closed = _SECTIONS.get(section.key, (_Section, section.key.lower(), True))
    members = {"bl_label": section.label, "section": section, "__doc__": content.__doc__}
    return twins(type(content.__name__, (content,), members), name, closed)


_SECTIONS: dict[str, tuple[type[_Section], str, bool]] = {
    "POSE": (_Pose, "pose", True),
    "IDENTITY": (_Identity, "identity", True),
    "DETAIL": (_Residual, "residual", True),
}  # content, end of the panel's name, closed at first
AVATAR = twins(_Avatar, "avatar", False)
SECTION_PANELS = tuple(panel for section in SECTIONS if section.key != "EXPRESSION" for panel in _panels_of(section))
