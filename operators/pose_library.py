"""The pose library: poses of the 60 named expressions as assets, saving and applying poses, the shelf in the 3D viewport."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..grmm_blender import poses, session_host
from ..grmm_blender.declare import Operator, flag, number, text
from ..grmm_blender.portraits import portrait, with_expression
from ..grmm_blender.rig.avatar import active_object, avatar_of
from ..grmm_blender.scene.cameras import close_camera
from ..grmm_core.controls.table import EXPRESSIONS
from ..grmm_core.errors import FileAccessError, GrmmError
from .common import Result, active_avatar, polls, reports_errors
from .edit import Edit
from .steps import Step, SteppedOperator, Steps


class GRMM_OT_create_pose_library(SteppedOperator, Operator):
    """Make a pose asset with a thumbnail for each named expression of the active avatar."""

    bl_label = "Create Pose Library"
    bl_description = (
        "Make a pose asset for each named expression, with a thumbnail of the active avatar; "
        "poses that are there get new thumbnails"
    )

    thumbnails: flag("Thumbnails", "Draw each pose with the active avatar; takes a runtime", default=True)
    poll = polls(active_avatar)

    def steps(self, context: bpy.types.Context) -> Steps:
        """One thumbnail a step."""
        avatar = active_avatar(context)
        controls, source = avatar.controls(), avatar.source
        draw = self.thumbnails
        if draw and not session_host.runtime_status().available:
            self.report({"WARNING"}, "There is no runtime: the poses have no thumbnails")
            draw = False
        pictures = {}  # all of them first: a cancelled run changes nothing
        for index, expression in enumerate(EXPRESSIONS if draw else ()):
            shown = with_expression(controls, {expression.name: 1.0})
            work = portrait(source, shown, close_camera, poses.THUMBNAIL, None)
            pictures[expression.name] = yield Step(index / len(EXPRESSIONS), expression.label, work)
        for expression in EXPRESSIONS:
            action = poses.make_pose(expression.label, poses.expression_values(expression.name), key=expression.name)
            if expression.name in pictures:
                poses.set_thumbnail(action, pictures[expression.name])
        return f"The pose library has {len(EXPRESSIONS)} poses{_write_catalogues()}"


class GRMM_OT_save_pose(Edit, Operator):
    """Save the active avatar's present expression as a pose asset of this file."""

    bl_label = "Save Expression as Pose"

    name: text("Name", "Name of the pose", default="Expression", maxlen=60)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Ask for the name."""
        return context.window_manager.invoke_props_dialog(self)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Save it; without a runtime it has no thumbnail."""
        if not self.name.strip():
            raise GrmmError("The pose has no name; give it one.")
        avatar = active_avatar(context)
        action = poses.make_pose(self.name.strip(), poses.present_values(avatar))
        if session_host.runtime_status().available:
            work = portrait(avatar.source, avatar.controls(), close_camera, poses.THUMBNAIL, None)
            poses.set_thumbnail(action, work(lambda: False))
        self.report({"INFO"}, f"Saved the pose {action.name}{_write_catalogues()}")
        return {"FINISHED"}


def _write_catalogues() -> str:
    """Write the catalogues beside the file; returns what to add to a message."""
    if not bpy.data.filepath:
        return "; save the file to see them in catalogues"
    poses.write_catalogues(Path(bpy.data.filepath).parent)
    return ""


_items: list[tuple[str, str, str]] = []  # Blender does not keep the strings of dynamic items


def _pose_items(_self: bpy.types.Operator, _context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    _items[:] = [(a.name, a.name, a.asset_data.description) for a in poses.local_poses()] or [("", "No poses", "")]
    return _items


class GRMM_OT_apply_pose(Edit, Operator):
    """Apply an expression of the pose library to the active avatar."""

    bl_label = "Apply Pose"
    bl_property = "pose"

    pose: bpy.props.EnumProperty(
        name="Pose", description="Pose of this file", items=_pose_items, options={"SKIP_SAVE", "HIDDEN"}
    )
    # What asset shelves fill in to say which asset was clicked.
    asset_library_type: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    asset_library_identifier: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    relative_asset_identifier: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    amount: number("Amount", "0 leaves the expression, 1 is the pose", default=1.0, min=0.0, max=1.0, subtype="FACTOR")
    add: flag("Add", "Add the pose to the present expression instead of replacing it")
    flip: flag("Flip", "Exchange the sides of the pose")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Search for a pose, unless one was clicked."""
        if self.relative_asset_identifier or getattr(context, "asset", None) is not None:
            return self.execute(context)
        if next(poses.local_poses(), None) is None:
            self.report({"ERROR"}, "This file has no poses; create the pose library first.")
            return {"CANCELLED"}
        context.window_manager.invoke_search_popup(self)
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        """How strongly, and how."""
        for name in ("amount", "add", "flip"):
            self.layout.prop(self, name)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Apply it; keyed where automatic keying is on."""
        avatar = active_avatar(context)
        values = self._values(context)
        if self.flip:
            values = poses.mirror(values)
        names = poses.apply_values(avatar, values, self.amount, self.add)
        if not names:
            raise GrmmError("The pose sets nothing on this avatar; choose an expression pose.")
        return self.finish(context, avatar, names)

    def _values(self, context: bpy.types.Context) -> poses.Values:
        asset = getattr(context, "asset", None)
        if self.relative_asset_identifier:
            return _values_of(self.relative_asset_identifier, _library_folder(self.asset_library_identifier))
        if asset is not None and asset.id_type == "ACTION":
            if asset.local_id is not None:
                return poses.read_pose(asset.local_id)
            return _values_of(asset.full_path, Path())
        action = bpy.data.actions.get(self.pose) if self.pose else None
        if action is None:
            raise GrmmError("No pose is chosen; create the pose library and choose one.")
        return poses.read_pose(action)


def _library_folder(name: str) -> Path:
    library = bpy.context.preferences.filepaths.asset_libraries.get(name)
    return Path(library.path) if library is not None else Path()


def _values_of(identifier: str, folder: Path) -> poses.Values:
    """Read the pose of an asset's path: "Action/NAME" in this file, "FILE.blend/Action/NAME" in a library."""
    place, in_library, name = identifier.replace("\\", "/").rpartition("/Action/")
    if not in_library:
        name = name.removeprefix("Action/")
    path = folder / place
    if not place or (bpy.data.filepath and path == Path(bpy.data.filepath)):
        action = bpy.data.actions.get(name)
        if action is None:
            raise GrmmError(f"This file has no pose {name}; create the pose library again.")
        return poses.read_pose(action)
    try:
        with bpy.data.libraries.load(str(path), link=False) as (found, wanted):
            wanted.actions = [entry for entry in found.actions if entry == name]
    except OSError as error:
        raise FileAccessError(f"Cannot read {path}; check the asset library in the preferences.") from error
    actions = [action for action in wanted.actions if action is not None]
    if not actions:
        raise FileAccessError(f"{path} has no pose {name}; refresh the asset library.")
    values = poses.read_pose(actions[0])
    bpy.data.actions.remove(actions[0])
    return values


class GRMM_AST_poses(bpy.types.AssetShelf):
    """Poses at the lower edge of the 3D viewport, with an avatar selected."""

    bl_space_type = "VIEW_3D"
    bl_idname = "GRMM_AST_poses"
    bl_activate_operator = GRMM_OT_apply_pose.bl_idname
    bl_default_preview_size = 64

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with an avatar selected."""
        return context.mode == "OBJECT" and avatar_of(active_object(context)) is not None

    @classmethod
    def asset_poll(cls, asset: bpy.types.AssetRepresentation) -> bool:
        """Only our poses."""
        return asset.id_type == "ACTION" and poses.TAG in asset.metadata.tags


def _asset_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    asset = context.asset
    if asset is not None and asset.id_type == "ACTION" and poses.TAG in asset.metadata.tags:
        self.layout.operator(GRMM_OT_apply_pose.bl_idname, text="Apply to GRMM Avatar")


CLASSES = (GRMM_OT_create_pose_library, GRMM_OT_save_pose, GRMM_OT_apply_pose, GRMM_AST_poses)


def register() -> None:
    """Add the entry to the asset browser's context menu."""
    bpy.types.ASSETBROWSER_MT_context_menu.append(_asset_menu)


def unregister() -> None:
    """Remove it."""
    bpy.types.ASSETBROWSER_MT_context_menu.remove(_asset_menu)
