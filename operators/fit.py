"""Avatars from photos: choose photos, look at what is found, fit, cancel, resume."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import bpy

from ..grmm_blender import session_host
from ..grmm_blender.declare import Operator, flag
from ..grmm_blender.fitting import watch
from ..grmm_blender.fitting.job import FitJob
from ..grmm_blender.fitting.photo_camera import set_photo_expression
from ..grmm_blender.fitting.provenance import provenance_sentence
from ..grmm_blender.fitting.settings import mask_paths, output_path, photo_paths, settings
from ..grmm_blender.properties import PHOTO_LIGHT
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_blender.scene.photo_light import photo_lighting
from ..grmm_core.errors import ConfigError
from ..grmm_core.fitting.request import FacesRequest, FitRequest
from .common import Result, active_avatar, check_object_mode, polls, reports_errors, require
from .importing import ImportsFiles

_EXTENSIONS = "*.jpg;*.jpeg;*.png;*.webp;*.tif;*.tiff;*.bmp"


def _check_idle(_context: bpy.types.Context) -> None:
    require(not watch.is_running(), "A fit is running; wait or cancel it")


def _check_photos(context: bpy.types.Context) -> None:
    """Photos are chosen and no fit is running."""
    require(photo_paths(settings(context)), "Choose a photo first")
    _check_idle(context)


def _check_waiting(context: bpy.types.Context) -> None:
    """A finished avatar waits; building its rig needs object mode."""
    require(watch.waits_to_be_added(), "There is no finished avatar that is not in the scene")
    check_object_mode(context)


def _photographed(context: bpy.types.Context) -> Avatar:
    """The active avatar, whose file was made from photos. Raises `UnavailableError`."""
    avatar = active_avatar(context)
    require(provenance_sentence(avatar.source), "Select an avatar that was made from photos")
    return avatar


class GRMM_OT_fit_add_photos(ImportsFiles, Operator):
    """Choose one or several photos of one person, who has agreed."""

    bl_label = "Add Photos"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=_EXTENSIONS, options={"HIDDEN"})
    poll = polls(_check_idle)

    def execute(self, context: bpy.types.Context) -> Result:
        """Append what was chosen to the list."""
        choices = settings(context)
        names = [str(Path(self.directory) / file.name) for file in self.files if file.name] or [self.filepath]
        known = {photo.path for photo in choices.photos}
        for name in names:
            if name and name not in known:
                choices.photos.add().path = name
        choices.active = max(0, len(choices.photos) - 1)
        return {"FINISHED"}


class GRMM_OT_fit_remove_photo(Operator):
    """Take the active photo off the list."""

    bl_label = "Remove Photo"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}
    poll = polls(_check_photos)

    def execute(self, context: bpy.types.Context) -> Result:
        """Remove it."""
        choices = settings(context)
        choices.photos.remove(min(choices.active, len(choices.photos) - 1))
        choices.active = max(0, min(choices.active, len(choices.photos) - 1))
        return {"FINISHED"}


class GRMM_OT_fit_find_faces(Operator):
    """Find faces, landmarks and the outline in the photos, to check the choice before fitting."""

    bl_label = "Find Faces"
    bl_options: ClassVar[set[str]] = {"REGISTER"}
    poll = polls(_check_photos)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Start the job."""
        choices = settings(context)
        folder = Path(bpy.app.tempdir) / "grmm_faces"
        return _run(self, context, FacesRequest(photo_paths(choices), folder, (choices.face - 1,), mask_paths(choices)))


class GRMM_OT_fit_photos(Operator):
    """Make an avatar of the person in the photos, in a process of its own, and add it to the scene."""

    bl_label = "Make Avatar"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    resume: flag("Resume", "Go on with a fit of the same photos that was interrupted")
    poll = polls(_check_photos)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Ask before an avatar that is there already is replaced."""
        output = output_path(settings(context))
        if self.resume or not output.exists():
            return self.execute(context)
        return context.window_manager.invoke_confirm(
            self, event, title="Replace Avatar?", confirm_text="Replace", icon="WARNING",
            message=f"{output.name} exists already. Choose another avatar file to keep it.",
        )  # fmt: skip

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Start the job; in background wait for it."""
        choices, runtime = settings(context), session_host.settings()
        some = [photo for photo in choices.photos if photo.path and photo.mask]
        if some and not mask_paths(choices):
            raise ConfigError("Only some photos have an outline; give one for each, or none.")
        request = FitRequest(
            photo_paths(choices), output_path(choices), choices.preset, (choices.face - 1,), mask_paths(choices),
            weights=runtime.weights, device=runtime.device, threads=runtime.threads, resume=self.resume,
        )  # fmt: skip
        request.check_output()
        return _run(self, context, request)


class GRMM_OT_fit_cancel(Operator):
    """Stop the running fit; what it has done is kept, so that it can be resumed."""

    bl_label = "Cancel"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    poll = polls(lambda _context: require(watch.is_running(), "No fit is running"))

    def execute(self, context: bpy.types.Context) -> Result:
        """Ask it to end."""
        watch.job().cancel()
        return {"FINISHED"}


class GRMM_OT_fit_add_to_scene(Operator):
    """Put the finished avatar into the scene, with the camera that took the photo."""

    bl_label = "Add to Scene"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    poll = polls(_check_waiting)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Add it."""
        self.report({"INFO"}, watch.add_to_scene(context))
        return {"FINISHED"}


class GRMM_OT_fit_photo_expression(Operator):
    """Set expression, pose and light of an avatar made from photos as the first photo shows them, to compare the two."""

    bl_label = "As in the Photo"

    light: flag("Light", "Light the avatar as the photo was lit", default=True)

    poll = polls(_photographed)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Set sliders, learned detail, bones and light."""
        avatar = _photographed(context)
        set_photo_expression(avatar)
        if self.light and photo_lighting(avatar.source) is not None:
            avatar.object.grmm.lighting = PHOTO_LIGHT
        avatar.tag_edited()
        return {"FINISHED"}


def _run(operator: bpy.types.Operator, context: bpy.types.Context, request: FitRequest | FacesRequest) -> Result:
    """Start a job; a window goes on, background mode waits. Raises `GrmmError`s."""
    watch.start(FitJob.start(session_host.job_python(), request), request)
    if bpy.app.background:
        watch.job().wait()
        operator.report({"INFO"}, watch.finish(context))
    return {"FINISHED"}


CLASSES = (
    GRMM_OT_fit_add_photos,
    GRMM_OT_fit_remove_photo,
    GRMM_OT_fit_find_faces,
    GRMM_OT_fit_photos,
    GRMM_OT_fit_cancel,
    GRMM_OT_fit_add_to_scene,
    GRMM_OT_fit_photo_expression,
)
