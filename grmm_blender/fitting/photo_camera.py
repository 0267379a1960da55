"""A photo in the scene: the camera that took it, with the photo behind the avatar, and the expression that it shows."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...grmm_core.avatar import load_avatar
from ...grmm_core.controls.names import EXPRESSION_NAMES, JOINT_NAMES
from ...grmm_core.controls.table import EXPRESSION, Z_EXP
from ...grmm_core.errors import ConfigError
from ...grmm_core.fitting.result import photo_controls
from ...grmm_core.geometry.camera import Camera
from ...grmm_core.head import load_open_head
from ...grmm_core.photo.orientation import orientation_of, upright
from ...grmm_core.session import HEAD_TO_BLENDER
from ..linking import link_beside
from ..rig.avatar import Avatar, avatar_of

_SENSOR = 36.0  # millimetres
_OPACITY = 0.5
_FRAME = 0.1  # of the distance from the head: how large a camera is drawn, else its frame is larger than the head
_COPY_SIDE = 2048  # pixels of a copy's longer side
_TO_BLENDER_AXES = np.diag([1.0, -1.0, -1.0, 1.0])  # a Blender camera looks along its -z with y up


def add_photo_camera(context: bpy.types.Context, head: bpy.types.Object, photo: Path, camera: Camera) -> bpy.types.Object:
    """Add the photo's camera, fastened to the avatar.

    Args:
        context: Of the operator.
        head: Head object of the avatar.
        photo: The picture; left out where it cannot be shown upright.
        camera: Of the whole photo, in head space.
    """
    data = bpy.data.cameras.new(f"{head.name} photo")
    item = bpy.data.objects.new(data.name, data)
    link_beside(item, head)
    avatar = avatar_of(head)
    item.parent = head if avatar is None else avatar.root
    pose = HEAD_TO_BLENDER @ np.linalg.inv(np.asarray(camera.world_to_camera, float)) @ _TO_BLENDER_AXES
    item.matrix_local = Matrix(pose.tolist())
    # The side on which the photo fills the scene's frame gives the angle of view: so the whole photo is seen, and the
    # background, which Blender fits into the frame, lies where the avatar is.
    upright = camera.width * _frame_height(context.scene) < camera.height * _frame_width(context.scene)
    side, focal = (camera.height, camera.fy) if upright else (camera.width, camera.fx)
    data.sensor_fit = "VERTICAL" if upright else "HORIZONTAL"
    data.sensor_width = data.sensor_height = _SENSOR
    data.lens = _SENSOR * focal / side
    data.shift_x = (camera.width / 2 - camera.cx) / side
    data.shift_y = (camera.cy - camera.height / 2) / side
    data.clip_start = 0.01
    data.display_size = min(data.display_size, _FRAME * float(np.linalg.norm(pose[:3, 3])))
    _add_background(data, photo, camera)
    if context.scene.camera is None:
        context.scene.camera = item
    return item


def set_photo_expression(avatar: Avatar, index: int = 0) -> None:
    """Set the rig as a photo shows the person: sliders, learned detail and bones; keys are not touched.

    Args:
        avatar: Made from photos.
        index: Which photo.

    Raises:
        FileAccessError, FileFormatError: Its file cannot be read.
        ShapeError: It has no such photo.
        ConfigError: It is made for another head model than the open one.
    """
    stored, head = load_avatar(avatar.source), load_open_head()
    if stored.head.name != head.name:
        raise ConfigError(f"{avatar.name} has the head model {stored.head.name!r}; only the open head's sliders can be set.")
    controls, target = photo_controls(stored, head, index).validate(), avatar.object
    for name, value in zip(EXPRESSION_NAMES, controls.aligned, strict=True):
        target[name] = float(value)
    for name in (EXPRESSION, Z_EXP):
        values = np.zeros(len(target[name]), np.float32)
        given = getattr(controls, name)[: len(values)]
        values[: len(given)] = given
        target[name] = values.tolist()
    for joint, angles in zip(JOINT_NAMES, controls.pose, strict=True):
        bone = avatar.bones.get(joint)
        if bone is not None and bone.parent is not None:
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = angles.tolist()


def _frame_width(scene: bpy.types.Scene) -> float:
    return scene.render.resolution_x * scene.render.pixel_aspect_x


def _frame_height(scene: bpy.types.Scene) -> float:
    return scene.render.resolution_y * scene.render.pixel_aspect_y


def _add_background(data: bpy.types.Camera, photo: Path, camera: Camera) -> None:
    try:
        image = bpy.data.images.load(str(photo), check_existing=True)
    except RuntimeError:
        return  # a format that Blender does not read
    orientation = orientation_of(photo)
    if orientation != 1:
        image = _turned(image, orientation)
    width, height = image.size
    if (width > height) != (camera.width > camera.height) and camera.width != camera.height:
        return  # not the picture that was fitted
    data.show_background_images = True
    background = data.background_images.new()
    background.image = image
    background.alpha = _OPACITY
    background.frame_method = "FIT"


def _turned(image: bpy.types.Image, orientation: int) -> bpy.types.Image:
    """A photo as its EXIF tag means it to be seen, which Blender does not follow: a smaller copy kept in the .blend file."""
    width, height = image.size
    if not width:  # its pixels cannot be read
        return image
    stored = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(stored)
    rows = upright(stored.reshape(height, width, 4)[::-1], orientation)[::-1]
    copy = bpy.data.images.new(f"{image.name} upright", rows.shape[1], rows.shape[0])
    copy.colorspace_settings.name = image.colorspace_settings.name
    copy.pixels.foreach_set(np.ascontiguousarray(rows).ravel())
    share = min(1.0, _COPY_SIDE / max(copy.size))
    if share < 1.0:
        copy.scale(*(max(1, round(side * share)) for side in copy.size))
    copy.pack()
    if not image.users:
        bpy.data.images.remove(image)
    return copy
