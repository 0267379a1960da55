"""Cameras as the core has them: of a render, of a 3D viewport, of portraits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...grmm_core.errors import ConfigError
from ...grmm_core.geometry.camera import Camera
from .shot import Region

SUPPORTED_CAMERAS = ("PERSP", "ORTHO")
FACE = (0.0, -0.01, 0.08)  # a point between nose and mouth, head space, metres
FACE_FOV, CLOSE_FOV = 15.0, 9.4  # degrees; show the head, and the face from chin to forehead
SHORTER_SIDE = 24.0  # of a sensor, millimetres: of a small picture on film
_FORMAT = {"w": "resolution_x", "h": "resolution_y", "x": "pixel_aspect_x", "y": "pixel_aspect_y"}
_LONGER_SIDE = f"{SHORTER_SIDE:g} * max(w * x, h * y) / min(w * x, h * y)"


@dataclass(frozen=True)
class Eye:
    """One of the two eyes of a stereo render.

    Attributes:
        camera_to_world: Where it stands, [4, 4].
        shift_x: Shift of its lens beyond the camera's own, in widths of the picture.
    """

    camera_to_world: np.ndarray
    shift_x: float = 0.0


def scene_camera(depsgraph: bpy.types.Depsgraph, override: bpy.types.Object | None = None) -> bpy.types.Object:
    """Return the evaluated object that a render looks through.

    Args:
        depsgraph: Evaluated scene.
        override: Camera in place of the scene's.

    Raises:
        ConfigError: No camera, or one that is neither perspective nor orthographic.
    """
    camera = override or depsgraph.scene_eval.camera
    if camera is None:
        raise ConfigError("The scene has no active camera; add one or make one active.")
    camera = camera.evaluated_get(depsgraph)
    if camera.type == "CAMERA" and camera.data.type not in SUPPORTED_CAMERAS:
        raise ConfigError(f"The camera {camera.name} is panoramic; the GRMM engine takes perspective and orthographic cameras.")
    return camera


def render_camera(
    depsgraph: bpy.types.Depsgraph, camera: bpy.types.Object, width: int, height: int, eye: Eye | None = None
) -> Camera:
    """Return the camera of the full picture without border.

    Args:
        depsgraph: Evaluated scene.
        camera: As `scene_camera` returns it.
        width: Pixels of the full picture, percentage included.
        height: The same.
        eye: Which one, in stereo.

    Raises:
        ConfigError: The camera is scaled to nothing.
    """
    render = depsgraph.scene_eval.render
    projection = camera.calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    placement = _rigid(np.array(camera.matrix_world if eye is None else eye.camera_to_world, np.float64))
    result = Camera.from_opengl(np.linalg.inv(placement), np.array(projection, np.float64), width, height)
    if eye is None or not eye.shift_x:
        return result
    return replace(result, cx=result.cx - eye.shift_x * _shift_unit(camera, result, render))


def clip_range(camera: bpy.types.Object) -> tuple[float, float]:
    """Return the nearest and farthest distance that an evaluated camera sees, metres."""
    if camera.type != "CAMERA":
        return 1e-4, 1e10
    return camera.data.clip_start if camera.data.type == "PERSP" else 1e-4, camera.data.clip_end


def fit_shorter_side(camera: bpy.types.Camera, lens: float, radius: float) -> float:
    """Return the distance from which a ball fills the shorter side of the picture, metres, whatever format that gets later.

    Blender fits a sensor to the longer side or to one that is chosen: a head that filled a wide picture would be small in a
    square one, or cut off in an upright one. So a driver makes the sensor wider as the picture gets longer. It is a simple
    expression, which Blender computes also where scripts are not trusted.

    Args:
        camera: Gets lens and sensor.
        lens: Focal length, millimetres.
        radius: Of the ball, metres.
    """
    camera.lens, camera.sensor_fit = lens, "AUTO"
    driver = camera.driver_add("sensor_width").driver
    driver.type, driver.expression = "SCRIPTED", _LONGER_SIDE
    for variable in list(driver.variables):
        driver.variables.remove(variable)
    for name, path in _FORMAT.items():
        variable = driver.variables.new()
        variable.name, variable.type = name, "CONTEXT_PROP"  # of whichever scene is rendered: no other one is kept in the file
        variable.targets[0].context_property = "ACTIVE_SCENE"
        variable.targets[0].data_path = f"render.{path}"
    return radius / math.sin(math.atan(SHORTER_SIDE / (2 * lens)))


def render_region(render: bpy.types.RenderSettings, width: int, height: int) -> Region:
    """Return the border in pixels, rounded as Blender rounds it, or the full picture.

    Args:
        render: Render settings.
        width: Pixels of the full picture.
        height: The same.

    Raises:
        ConfigError: The border has no pixel.
    """
    if not render.use_border:
        return Region(0, 0, width, height)
    # Blender multiplies in single precision and cuts the fraction off.
    x0, x1 = (int(np.float32(edge) * np.float32(width)) for edge in (render.border_min_x, render.border_max_x))
    y0, y1 = (int(np.float32(edge) * np.float32(height)) for edge in (render.border_min_y, render.border_max_y))
    if x1 <= x0 or y1 <= y0:
        raise ConfigError("The render border is empty; draw it again (Ctrl-B in the camera view) or switch it off.")
    return Region(x0, y0, x1 - x0, y1 - y0)


def view_camera(region: bpy.types.Region, region_data: bpy.types.RegionView3D) -> Camera:
    """Return the camera of a 3D viewport, in whatever way it looks."""
    view = np.array(region_data.view_matrix, np.float64)
    return Camera.from_opengl(view, np.array(region_data.window_matrix, np.float64), region.width, region.height)


def face_camera(size: int, yaw: float = 12.0) -> Camera:
    """Return a camera in head space that shows the head.

    Args:
        size: Pixels of the square picture.
        yaw: Degrees to the subject's left.
    """
    return Camera.orbit(size, size, yaw=yaw, distance=1.0, fov=FACE_FOV, target=FACE)


def close_camera(size: int) -> Camera:
    """Return a camera in head space that shows the face alone, from the front: what tells small pictures apart."""
    return Camera.orbit(size, size, distance=1.0, fov=CLOSE_FOV, target=FACE)


def same_camera(one: Camera, other: Camera) -> bool:
    """Whether two cameras show the same picture."""
    names = ("fx", "fy", "cx", "cy", "width", "height", "orthographic")
    return all(getattr(one, name) == getattr(other, name) for name in names) and np.array_equal(
        one.world_to_camera, other.world_to_camera
    )


def _shift_unit(camera: bpy.types.Object, picture: Camera, render: bpy.types.RenderSettings) -> float:
    """Pixels that a lens shift of 1 moves the picture sideways: the side of the picture that the sensor is fitted to."""
    height = picture.height * render.pixel_aspect_y / render.pixel_aspect_x
    fit = camera.data.sensor_fit
    horizontal = fit == "HORIZONTAL" or (fit == "AUTO" and picture.width >= height)
    return float(picture.width if horizontal else height)


def _rigid(matrix: np.ndarray) -> np.ndarray:
    """Return a placement [4, 4] without its axes' lengths."""
    result = matrix.copy()
    lengths = np.linalg.norm(result[:3, :3], axis=0)
    if (lengths < 1e-12).any():
        raise ConfigError("The camera is scaled to zero; apply or reset its scale.")
    result[:3, :3] /= lengths
    return result
