"""Add an avatar to the scene: one that comes with the extension, a random person, or a `.grmm` file."""

from __future__ import annotations

import random
from typing import ClassVar

import bpy

from ..grmm_blender.rig.avatar import stored_path
from ..grmm_blender.rig.build import build_avatar
from ..grmm_blender.rig.identity import DEFAULT_SOURCE, read_identity
from ..grmm_blender.session_host import SAMPLE_PREFIX
from ..grmm_core.avatar import EXTENSION
from ..grmm_core.avatar.library import LIBRARY_PREFIX, library_names
from ..grmm_core.errors import GrmmError

LIBRARY_ITEMS = tuple(
    (name, name.replace("_", " ").capitalize(), f"The avatar {name} of the library") for name in library_names()
)


class GRMM_OT_add_head(bpy.types.Operator):
    """Add an animatable GRMM head with its rig at the 3D cursor."""

    bl_idname = "grmm.add_head"
    bl_label = "Add GRMM Head"
    bl_description = "Add an animatable GRMM head with its rig at the 3D cursor"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    person: bpy.props.EnumProperty(
        name="Person",
        description="Who the head is",
        items=(
            ("DEFAULT", "Default", "The avatar that comes with the weights"),
            ("LIBRARY", "Library", "One of the avatars that come with the extension"),
            ("RANDOM", "Random Person", "A person drawn from the model"),
            ("FILE", "File", "An avatar file"),
        ),
        default="DEFAULT",
    )
    library: bpy.props.EnumProperty(name="Avatar", description="Which avatar of the library", items=LIBRARY_ITEMS)
    seed: bpy.props.IntProperty(name="Seed", description="Number of the random person", default=1, min=0)
    filepath: bpy.props.StringProperty(name="File", description="Avatar file (.grmm)", subtype="FILE_PATH", default="")
    relative_path: bpy.props.BoolProperty(
        name="Relative Path", description="Store the file name relative to the .blend file", default=True
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Building the armature needs object mode."""
        if context.mode != "OBJECT":
            cls.poll_message_set("Go to object mode first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Draw another person each time that a random one is asked for without a seed."""
        if self.person == "RANDOM" and not self.properties.is_property_set("seed"):
            self.seed = random.randrange(1, 1 << 20)
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Build the avatar."""
        try:
            stored, source = self._source()
            build_avatar(context, stored, read_identity(source))
        except GrmmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Show the options that matter for the person chosen."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "person")
        if self.person == "LIBRARY":
            layout.prop(self, "library")
        elif self.person == "RANDOM":
            layout.prop(self, "seed")
        elif self.person == "FILE":
            layout.prop(self, "filepath")
            layout.prop(self, "relative_path")

    def _source(self) -> tuple[str, str]:
        """What to store, and what to open now."""
        if self.person == "RANDOM":
            return (f"{SAMPLE_PREFIX}{self.seed}",) * 2
        if self.person == "LIBRARY":
            return (f"{LIBRARY_PREFIX}{self.library}",) * 2
        if self.person == "DEFAULT" and not self.filepath:
            return DEFAULT_SOURCE, DEFAULT_SOURCE
        if not self.filepath:
            raise GrmmError("No avatar file is chosen; choose a .grmm file.")
        absolute = bpy.path.abspath(self.filepath)
        return stored_path(absolute, self.relative_path), absolute


class GRMM_OT_open_avatar(bpy.types.Operator):
    """Choose an avatar file and add it to the scene."""

    bl_idname = "grmm.open_avatar"
    bl_label = "Open GRMM Avatar"
    bl_description = "Choose an avatar file and add it to the scene"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filepath: bpy.props.StringProperty(
        name="File", description="Avatar file (.grmm)", subtype="FILE_PATH", options={"SKIP_SAVE"}
    )
    filter_glob: bpy.props.StringProperty(default=f"*{EXTENSION}", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """As for adding a head."""
        return GRMM_OT_add_head.poll.__func__(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the head of the file."""
        return bpy.ops.grmm.add_head("EXEC_DEFAULT", True, person="FILE", filepath=self.filepath)


class GRMM_MT_library(bpy.types.Menu):
    """Avatars that come with the extension."""

    bl_idname = "GRMM_MT_library"
    bl_label = "GRMM Library"

    def draw(self, context: bpy.types.Context) -> None:
        """One entry for each avatar."""
        for name, label, _ in LIBRARY_ITEMS:
            entry = self.layout.operator(GRMM_OT_add_head.bl_idname, text=label, icon="COMMUNITY")
            entry.person, entry.library = "LIBRARY", name


def _menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    layout = self.layout
    layout.separator()
    layout.operator_context = "INVOKE_DEFAULT"
    layout.operator(GRMM_OT_add_head.bl_idname, text="GRMM Head", icon="COMMUNITY").person = "DEFAULT"
    layout.menu(GRMM_MT_library.bl_idname, icon="COMMUNITY")
    layout.operator(GRMM_OT_add_head.bl_idname, text="GRMM Random Person", icon="COMMUNITY").person = "RANDOM"
    layout.operator(GRMM_OT_open_avatar.bl_idname, text="GRMM Avatar File...", icon="FILE_FOLDER")


CLASSES = (GRMM_OT_add_head, GRMM_OT_open_avatar, GRMM_MT_library)


def register() -> None:
    """Add the menu entries."""
    bpy.types.VIEW3D_MT_add.append(_menu)


def unregister() -> None:
    """Remove the menu entries."""
    bpy.types.VIEW3D_MT_add.remove(_menu)
