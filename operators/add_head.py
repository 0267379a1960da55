"""Add an avatar to the scene: one that comes with the extension, a random person, or a `.grmm` file."""

from __future__ import annotations

import random

import bpy

from ..grmm_blender import staging
from ..grmm_blender.declare import Operator, choice, flag, text, whole
from ..grmm_blender.rig.avatar import stored_path
from ..grmm_blender.rig.build import build_avatar
from ..grmm_blender.rig.identity import DEFAULT_SOURCE, read_identity
from ..grmm_core.avatar import EXTENSION
from ..grmm_core.avatar.library import DEFAULT_NAME, LIBRARY_PREFIX, library_names
from ..grmm_core.errors import FileAccessError
from ..grmm_core.session.sources import SAMPLE_PREFIX
from .common import OperatorMixin, Result, check_object_mode, menu_entries, polls, reports_errors
from .importing import ImportsFiles, TakesDrops

LIBRARY_ITEMS = tuple((name, name.replace("_", " ").title(), f"The avatar {name} of the library") for name in library_names())
_NOT_KEPT = {"SKIP_SAVE"}


class PlacesHead(OperatorMixin):
    """Mixin of operators that add a head: where it stands. For somebody who watches it stands where it can be seen."""

    stand: flag(
        "Stand on Cursor",
        "Put the lower edge, not the middle of the head, at the 3D cursor, so that no floor runs through the face",
        options=_NOT_KEPT,
    )
    set_up: flag(
        "Set Up Scene",
        "Put camera and viewport before the head and render with GRMM; on at first in Blender's startup scene",
        options=_NOT_KEPT,
    )
    poll = polls(check_object_mode)

    def watch(self, context: bpy.types.Context) -> None:
        """Choose what suits somebody who looks at the viewport; scripts get what they ask for."""
        for name, value in (("stand", True), ("set_up", staging.is_as_started(context.scene))):
            if not self.properties.is_property_set(name):
                setattr(self, name, value)

    def add(self, context: bpy.types.Context, stored: str, source: str) -> None:
        """Build the head of a source.

        Args:
            context: In object mode.
            stored: What the scene keeps of the source.
            source: What is opened now.

        Raises:
            GrmmError: The source cannot be used.
        """
        fresh = staging.is_as_started(context.scene)
        avatar = build_avatar(context, stored, read_identity(source))
        if self.stand:
            staging.stand_up(avatar)
        if self.set_up:
            staging.set_up(context, avatar, fresh)


class GRMM_OT_add_head(PlacesHead, Operator):
    """Add an animatable GRMM head with its rig at the 3D cursor."""

    bl_label = "Add GRMM Head"

    person: choice(
        "Person",
        "Who the head is",
        ("DEFAULT", "Default", "The avatar that comes with the weights"),
        ("LIBRARY", "Library", "One of the avatars that come with the extension"),
        ("RANDOM", "Random Person", "A person drawn from the model"),
        ("FILE", "File", "An avatar file"),
    )
    library: choice("Avatar", "Which avatar of the library", *LIBRARY_ITEMS)
    seed: whole("Seed", "Number of the random person", default=1, min=0)
    filepath: text("File", "Avatar file (.grmm)", subtype="FILE_PATH")
    relative_path: flag("Relative Path", "Store the file name relative to the .blend file", default=True)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Draw another person each time that a random one is asked for without a seed."""
        if self.person == "RANDOM" and not self.properties.is_property_set("seed"):
            self.seed = random.randrange(1, 1 << 20)
        self.watch(context)
        return self.execute(context)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Build the avatar."""
        self.add(context, *self._source())
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Show the options that matter for the person chosen."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "person")
        shown = {"LIBRARY": ("library",), "RANDOM": ("seed",), "FILE": ("filepath", "relative_path")}
        for name in (*shown.get(self.person, ()), "stand", "set_up"):
            layout.prop(self, name)

    def _source(self) -> tuple[str, str]:
        """What to store, and what to open now."""
        if self.person == "RANDOM":
            return (f"{SAMPLE_PREFIX}{self.seed}",) * 2
        if self.person == "LIBRARY":
            return (f"{LIBRARY_PREFIX}{self.library}",) * 2
        if self.person == "DEFAULT" and not self.filepath:
            return DEFAULT_SOURCE, DEFAULT_SOURCE
        return file_source(self.filepath, self.relative_path)


class GRMM_OT_open_avatar(PlacesHead, ImportsFiles, Operator):
    """Choose an avatar file and add it to the scene."""

    bl_label = "Open GRMM Avatar"

    filepath: text("File", "Avatar file (.grmm)", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=f"*{EXTENSION}", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Open the file browser, unless a file was dropped."""
        self.watch(context)
        return ImportsFiles.invoke(self, context, event)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Add the head of the file."""
        self.add(context, *file_source(self.filepath))
        return {"FINISHED"}


def file_source(filepath: str, relative: bool = True) -> tuple[str, str]:
    """Return what to store for an avatar file, and its absolute path. Raises `FileAccessError` where none is chosen."""
    if not filepath:
        raise FileAccessError("No avatar file is chosen; choose a .grmm file.")
    absolute = bpy.path.abspath(filepath)
    return stored_path(absolute, relative), absolute


class GRMM_FH_avatar(TakesDrops, bpy.types.FileHandler):
    """Take avatar files that are dropped into the 3D viewport."""

    bl_idname = "GRMM_FH_avatar"
    bl_label = "GRMM Avatar"
    bl_import_operator = GRMM_OT_open_avatar.bl_idname
    bl_file_extensions = EXTENSION


class GRMM_MT_add(bpy.types.Menu):
    """Heads to add."""

    bl_idname = "GRMM_MT_add"
    bl_label = "GRMM"

    def draw(self, context: bpy.types.Context) -> None:
        """Who comes with the extension, random people, files."""
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        layout.operator(GRMM_OT_add_head.bl_idname, text="Default", icon="COMMUNITY").person = "DEFAULT"
        for name, label, _ in LIBRARY_ITEMS:
            if name != DEFAULT_NAME:
                entry = layout.operator(GRMM_OT_add_head.bl_idname, text=label, icon="COMMUNITY")
                entry.person, entry.library = "LIBRARY", name
        layout.separator()
        layout.operator(GRMM_OT_add_head.bl_idname, text="Random Person", icon="COMMUNITY").person = "RANDOM"
        layout.operator(GRMM_OT_open_avatar.bl_idname, text="Avatar File...", icon="FILE_FOLDER")
        layout.operator("grmm.add_flame_head", text="FLAME Head...", icon="MONKEY")
        layout.separator()
        layout.menu("GRMM_MT_add_hair", icon="CURVES")


def _menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.menu(GRMM_MT_add.bl_idname, icon="COMMUNITY")


CLASSES = (GRMM_OT_add_head, GRMM_OT_open_avatar, GRMM_FH_avatar, GRMM_MT_add)
_add_import, _remove_import = menu_entries(bpy.types.TOPBAR_MT_file_import, (GRMM_OT_open_avatar, f"GRMM Avatar ({EXTENSION})"))


def register() -> None:
    """Add the menu entries."""
    bpy.types.VIEW3D_MT_add.append(_menu)
    _add_import()


def unregister() -> None:
    """Remove the menu entries."""
    _remove_import()
    bpy.types.VIEW3D_MT_add.remove(_menu)
