"""What the user has chosen for a fit: photos, outlines, face, preset, file. Kept on the window manager, not in the .blend."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import CollectionProperty, PointerProperty

from ...grmm_core.avatar import EXTENSION
from ...grmm_core.fitting.folder import can_resume
from ...grmm_core.fitting.request import work_folder
from ..declare import choice, text, whole

PROPERTY = "grmm_fit"
PRESET_ITEMS = (
    ("fast", "Fast", "About a minute: a likeness to judge the photos by"),
    ("standard", "Standard", "Some minutes: the avatar to work with"),
    ("high", "High", "Many minutes: the finest detail"),
)


class GRMM_FitPhoto(bpy.types.PropertyGroup):
    """One photo."""

    path: text("Photo", "Photo of the person; the first one gives the light", subtype="FILE_PATH")
    mask: text(
        "Outline",
        "Picture of the person's outline, white on black, where the one that was found is wrong; empty uses that",
        subtype="FILE_PATH",
    )
    faces: whole("Faces", "Faces found in this photo; 0 before it was looked at", min=0)
    faces_picture: text("Faces", "Picture of the faces that were found", options={"HIDDEN"})


class GRMM_FitSettings(bpy.types.PropertyGroup):
    """Choices of the fit panel."""

    photos: CollectionProperty(name="Photos", description="Photos of one person", type=GRMM_FitPhoto)
    active: whole("Photo", "Photo that is shown", min=0)
    face: whole("Face", "Which face, where a photo shows several; the largest is 1", default=1, min=1, max=99)
    preset: choice("Preset", "Amount of work", *PRESET_ITEMS, default="standard")
    output: text("Save As", "File of the finished avatar; empty writes beside the first photo", subtype="FILE_PATH")


def settings(context: bpy.types.Context) -> GRMM_FitSettings:
    """Return the choices."""
    return getattr(context.window_manager, PROPERTY)


def photo_paths(choices: GRMM_FitSettings) -> tuple[Path, ...]:
    """Absolute paths of the photos."""
    return tuple(Path(bpy.path.abspath(photo.path)) for photo in choices.photos if photo.path)


def mask_paths(choices: GRMM_FitSettings) -> tuple[Path, ...]:
    """Absolute paths of the outlines, where every photo has one; else none."""
    masks = tuple(Path(bpy.path.abspath(photo.mask)) for photo in choices.photos if photo.path and photo.mask)
    return masks if len(masks) == len(photo_paths(choices)) else ()


def output_path(choices: GRMM_FitSettings) -> Path:
    """Where the avatar goes; needs a photo where no file is chosen."""
    if choices.output:
        path = Path(bpy.path.abspath(choices.output))
        return path if path.suffix == EXTENSION else path.with_name(path.name + EXTENSION)
    return photo_paths(choices)[0].with_suffix(EXTENSION)


def can_go_on(choices: GRMM_FitSettings) -> bool:
    """Whether a fit of this avatar's file was interrupted, in this Blender or an earlier one."""
    if not photo_paths(choices):
        return False
    return can_resume(work_folder(output_path(choices)))


CLASSES = (GRMM_FitPhoto, GRMM_FitSettings)


def register() -> None:
    """Put the choices on the window manager."""
    setattr(bpy.types.WindowManager, PROPERTY, PointerProperty(type=GRMM_FitSettings))


def unregister() -> None:
    """Take them away."""
    delattr(bpy.types.WindowManager, PROPERTY)
