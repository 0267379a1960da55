"""The avatar's panels: who it is, its sliders by region, pose, learned detail, and what runs the model.

Each panel stands in the sidebar's GRMM tab and, as a twin, in the object data tab. They draw the custom properties of the
selected avatar (see `rig.definitions`) and follow the selection: head or armature.
"""

from __future__ import annotations

import bpy

from ..rig import live
from ..rig.avatar import Avatar, avatar_of
from ..rig.codes import SLOTS, blend_name, saved_slots
from ..rig.components import components
from ..rig.definitions import ARRAY_NAMES, CONTROL_JOINTS, REGIONS, SHAPE, STRENGTH, Z_EXP, Z_ID, label, mirrored, property_path
from ..session_host import runtime_status
from .width import draw_text, is_narrow

CATEGORY = "GRMM"
ALL = "ALL"  # of the operators' regions
LEADING_COMPONENTS = 8  # of an array; the rest is reached through the object's custom properties
SHORT_NAME = 15  # characters that a slider shows beside its value while the sidebar has its first width
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


class _Expression(_AvatarPanel):
    """The aligned expressions by region."""

    bl_label = "Expression"

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """One box for each region; the two sides of an expression stand in one row where there is room for it."""
        head = avatar.object
        layout.use_property_split = False
        narrow = is_narrow(context)
        _draw_edits(layout, ALL, narrow)
        for region, names in REGIONS.items():
            box = layout.box().column(align=True)
            header = box.row(align=True)
            header.label(text=region)
            _draw_edits(header, region, narrow)
            drawn: set[str] = set()
            for name in names:
                if name in drawn or name not in head:
                    continue
                partner = mirrored(name)
                # The subject's right side stands on the left, as it does on the face that looks at the animator.
                pair = [n for n in dict.fromkeys((partner, name)) if n in names] if name.endswith("Left") else [name]
                row = box.column(align=True) if narrow else box.row(align=True)
                for member in pair:
                    text = _short(label(member), region) if narrow else label(member)
                    row.prop(head, property_path(member), text=text, slider=True)
                drawn.update(pair)


class _Pose(_AvatarPanel):
    """Neck, jaw and eyes."""

    bl_label = "Pose"

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """The bones' rotations, so that panel and viewport edit the same thing."""
        if avatar.armature is None:
            layout.label(text="The armature is missing; add the head again", icon="ERROR")
            return
        row = layout.row(align=True)
        row.operator("grmm.reset", text="Reset", icon="LOOP_BACK").what = "POSE"
        row.operator("grmm.calibrate_neutral", text="Neutral", icon="ARMATURE_DATA")
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

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Random person, the leading components, saved persons."""
        row = layout.row(align=True)
        row.operator("grmm.random_identity", text="Random", icon="COMMUNITY")
        row.operator("grmm.reset", text="Reset", icon="LOOP_BACK").what = "IDENTITY"
        _draw_array(layout, avatar, SHAPE)
        _draw_code(layout, avatar, Z_ID)


class _Residual(_AvatarPanel):
    """The learned detail."""

    bl_label = "Learned Detail"

    def draw_avatar(self, layout: bpy.types.UILayout, avatar: Avatar, context: bpy.types.Context) -> None:
        """Strength, the residual expression code, saved codes."""
        if Z_EXP not in avatar.object:
            layout.label(text="No network draws this head", icon="INFO")
            return
        layout.prop(avatar.object, property_path(STRENGTH), text="Strength", slider=True)
        row = layout.row(align=True)
        row.operator("grmm.random_detail", text="Random", icon="MOD_NOISE")
        row.operator("grmm.reset", text="Reset", icon="LOOP_BACK").what = "DETAIL"
        _draw_code(layout, avatar, Z_EXP)


def _short(text: str, region: str) -> str:
    """Shorten the sides, and leave out the region where even then the end, which tells the sides apart, would be cut off."""
    for word, letter in (("Right", "R"), ("Left", "L")):
        if text.endswith(f" {word}"):
            text = text[: -len(word)] + letter
    first, _, rest = text.partition(" ")
    return rest if len(text) > SHORT_NAME and region.startswith(first) else text


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


def _draw_array(layout: bpy.types.UILayout, avatar: Avatar, name: str, labels: dict[int, str] | None = None) -> None:
    """The leading components of an array; `labels` says which, and in what words."""
    if name not in ARRAY_NAMES or name not in avatar.object:
        return
    column = layout.column(align=True)
    column.label(text={SHAPE: "Shape", Z_ID: "Residual Identity", Z_EXP: "Residual Expression"}[name])
    if labels is None:
        labels = {index: "" for index in range(min(LEADING_COMPONENTS, len(avatar.object[name])))}
    for index, words in labels.items():
        column.prop(avatar.object, property_path(name), index=index, text=f"{index} {words}".strip(), slider=True)


def _draw_code(layout: bpy.types.UILayout, avatar: Avatar, name: str) -> None:
    """A residual code: its components that are seen most, by what they do, and the blend of saved states."""
    head = avatar.object
    if name not in head:
        return
    leading = components(name, len(head[name]))[:LEADING_COMPONENTS]
    _draw_array(layout, avatar, name, {component.index: component.label for component in leading})
    column = layout.column(align=True)
    saved = saved_slots(head, name)
    row = column.row(align=True)
    for slot in SLOTS:
        options = row.operator("grmm.save_code", text=f"{'Replace' if slot in saved else 'Save'} {slot.upper()}")
        options.code, options.slot = name, slot.upper()
    if len(saved) == len(SLOTS):
        column.prop(head, property_path(blend_name(name)), text="Blend A to B", slider=True)
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
