"""Properties of the extension on Blender's data that are not controls: what makes an object an avatar.

The controls themselves are custom properties (see `rig.custom_properties`), which keep working where the extension is absent.
"""

from __future__ import annotations

from typing import Any

import bpy

from ..grmm_core.controls.names import JOINT_NAMES
from ..grmm_core.hair import SETTINGS
from ..grmm_core.session.values import MAX_WRINKLES
from .declare import choice, flag, number, text, whole
from .hair import grooms
from .hair.grooms import HAIR_ITEMS, OWN_HAIR, PART_ITEMS, label_of, numbered
from .rig.avatar import Avatar, is_avatar
from .rig.build import add_missing_controls, show_source
from .rig.identity import DEFAULT_SOURCE

STUDIO_LIGHT, SCENE_LIGHT, PHOTO_LIGHT = "STUDIO", "SCENE", "PHOTO"  # items of `lighting`


@bpy.app.handlers.persistent
def _complete(*_: object) -> None:
    """Give the heads of a file that was just opened the controls that have come since it was saved."""
    for obj in bpy.data.objects:
        if is_avatar(obj):
            add_missing_controls(Avatar(obj))


def _changed(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Have the head looked at again (see `handlers`)."""
    self.id_data.update_tag()


def _source_changed(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Give the rig the shape of the avatar that was named; a file that cannot be used is said in the panel."""
    if self.is_avatar:
        show_source(Avatar(self.id_data))


_OVERRIDABLE: dict[str, Any] = {"override": {"LIBRARY_OVERRIDABLE"}}
_LIVE: dict[str, Any] = {**_OVERRIDABLE, "update": _changed}
_FACTOR: dict[str, Any] = {"default": 1.0, "min": 0.0, "soft_max": 3.0, **_LIVE}


_pictured: list[tuple[str, str, str, str | int, int]] = []  # Blender does not keep the texts of a list that is made for it


def _are_curves(_group: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "CURVES"


def _pictured_items(_group: bpy.types.PropertyGroup, _context: bpy.types.Context) -> list[tuple[str, str, str, str | int, int]]:
    """The items of hair with their pictures."""
    if not _pictured:
        _pictured[:] = [
            (*item, "USER" if item[0] == OWN_HAIR else grooms.icon_of(item[0].lower()), number)
            for number, item in enumerate(HAIR_ITEMS)
        ]
    return _pictured


def _picked(self: bpy.types.PropertyGroup) -> int:
    return [name for name, *_ in HAIR_ITEMS].index(self.groom)


def _pick(self: bpy.types.PropertyGroup, value: int) -> None:
    wear(self, HAIR_ITEMS[value][0])


def wear(hair: bpy.types.PropertyGroup, groom: str) -> None:
    """Have an avatar wear a groom, one of `HAIR_ITEMS`; curves that were its hair stay in the scene as what they are."""
    hair.curves = None
    hair.groom = groom


class GRMM_PG_hair(bpy.types.PropertyGroup):
    """What hair an avatar wears: a groom, or curves; besides one number for each of the core's `SETTINGS`."""

    groom: choice("Hair", "What hair the avatar wears", *numbered(HAIR_ITEMS), **_LIVE)
    picked: bpy.props.EnumProperty(
        name="Hair",
        description="What hair the avatar wears, in the place of curves as well",
        items=_pictured_items,
        get=_picked,
        set=_pick,
        options=set(),
    )
    curves: bpy.props.PointerProperty(
        type=bpy.types.Object,
        name="Curves",
        description="A Curves object on the head's surface that is the hair, in the place of the groom",
        poll=_are_curves,
        **_LIVE,
    )
    seed: whole("Seed", "Number of the hair at random", min=0, max=999_999_999, **_LIVE)
    __annotations__ |= {
        part: choice(label_of(part), f"What {part} the avatar wears", *numbered(items), **_LIVE)
        for part, items in PART_ITEMS.items()
    }
    swing: flag("Swing", "Long hair lags behind the moving head and swings, as it was baked", **_LIVE)
    swing_file: text(
        "Baked Swing", "File of the baked hair", subtype="FILE_PATH", options={"PATH_SUPPORTS_BLEND_RELATIVE"}, **_OVERRIDABLE
    )
    swing_known: text("Known Bake", "Where the file was when it was baked", options={"HIDDEN"}, **_OVERRIDABLE)
    swing_of: text("Baked Hair", "The person and the hair that were baked", options={"HIDDEN"}, **_OVERRIDABLE)
    swing_digest: text("Baked Movement", "What the file must hold to be what was baked", options={"HIDDEN"}, **_OVERRIDABLE)
    __annotations__ |= {
        row.name: number(label_of(row.name), row.text, default=row.default, min=row.low, max=row.high, **_LIVE)
        for row in SETTINGS
    }  # fmt: skip


class GRMM_PG_avatar(bpy.types.PropertyGroup):
    """Settings of a head object."""

    is_avatar: flag("Avatar", "This mesh is the head of a GRMM avatar", options={"HIDDEN"})
    source: text(
        "Source",
        'The avatar that is drawn: "default", "sample:NUMBER", or a .grmm file',
        default=DEFAULT_SOURCE,
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        update=_source_changed,
    )
    known_path: text(
        "Known Path",
        "Where the source was when it was last read; found there again after the object was appended elsewhere",
        options={"HIDDEN"},
    )
    head_name: text("Head model", "Head model that the rig was built from", options={"HIDDEN"})
    joint_offset: bpy.props.FloatVectorProperty(
        name="Joint Offset",
        description="From the joints that the armature was built with to those of the avatar, head axes, metres",
        size=3 * len(JOINT_NAMES),
        options={"HIDDEN"},
    )
    lighting: choice(
        "Lighting",
        "What lights the avatar",
        (STUDIO_LIGHT, "Studio", "The even light that its colors were learned in, whatever the scene has"),
        (SCENE_LIGHT, "Scene", "The scene's lamps and world"),
        (PHOTO_LIGHT, "Photo", "The light of the first photo that the avatar was made from"),
        **_LIVE,
    )
    hair: bpy.props.PointerProperty(
        type=GRMM_PG_hair, name="Hair", description="What hair the avatar wears", override={"LIBRARY_OVERRIDABLE"}
    )
    light_intensity: number("Intensity", "Factor of all light on the avatar", **_FACTOR)
    skin_gloss: number("Gloss", "Factor of highlights on skin, eyes, teeth and hair", **_FACTOR)
    skin_detail: number("Skin Detail", "Factor of the pores and furrows of skin; 0: smooth as the mesh", **_FACTOR)
    skin_scattering: number("Scattering", "How far light wanders inside the skin: softer, redder edges of shadows", **_FACTOR)
    shadow_softness: number("Shadow Softness", "Factor of the size that lamps have for shadows on the avatar", **_FACTOR)
    wrinkles: number(
        "Wrinkles", "Factor of the furrows that expressions draw into the skin of pictures; 0: none",
        **{**_FACTOR, "soft_max": 2.0, "max": MAX_WRINKLES},
    )  # fmt: skip
    live_detail: flag(
        "Learned Detail on Mesh",
        "Keep the residual shape key up to date with the model, so that the mesh shows the learned displacement",
        default=True,
        **_LIVE,
    )
    detail_in_playback: flag(
        "Also During Playback",
        "Update the learned detail on every frame of playback; slower. Renders always have it",
        override={"LIBRARY_OVERRIDABLE"},
    )


CLASSES = (GRMM_PG_hair, GRMM_PG_avatar)


def register() -> None:
    """Attach the groups to Blender's types."""
    bpy.types.Object.grmm = bpy.props.PointerProperty(type=GRMM_PG_avatar, name="GRMM Avatar", override={"LIBRARY_OVERRIDABLE"})
    bpy.app.handlers.load_post.append(_complete)
    grooms.register()


def unregister() -> None:
    """Take the groups back; the values stay in the files."""
    grooms.unregister()
    _pictured.clear()
    bpy.app.handlers.load_post.remove(_complete)
    del bpy.types.Object.grmm
