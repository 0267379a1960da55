"""What a picture needs from the evaluated scene, copied into plain numpy values.

Called by `final` and `view`. After `take` returns, nothing of it refers to Blender's data, so that it may cross threads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...grmm_core.controls.frame import Controls
from ...grmm_core.errors import ConfigError
from ...grmm_core.geometry.camera import Camera
from ..splats import CloudShot

SUPPORTED_CAMERAS = ("PERSP", "ORTHO")


@dataclass(frozen=True)
class AvatarShot:
    """An avatar, or a splat cloud, as it is in one frame.

    Attributes:
        name: Name of its head object, or of the cloud object.
        source: What `session_host.open_avatar` takes; "" for a cloud.
        controls: Expression and pose.
        model_to_world: Head space to Blender's world, [4, 4].
        holdout: It cuts a hole instead of being drawn.
        cloud: What `session_host.open_cloud` takes, for a cloud.
    """

    name: str
    source: str
    controls: Controls
    model_to_world: np.ndarray
    holdout: bool = False
    cloud: CloudShot | None = None


@dataclass(frozen=True, eq=False)
class Occluder:
    """A mesh in front of which or behind which avatars may stand.

    Attributes:
        triangles: Corners in the mesh's own space, [T, 3, 3]. Never written to: the same array is the same mesh.
        matrix: Places it in the world, [4, 4] float64.
    """

    triangles: np.ndarray
    matrix: np.ndarray

    def placed(self) -> np.ndarray:
        """Return the corners in the world, [T, 3, 3] float32."""
        world = self.triangles.reshape(-1, 3) @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        return world.astype(np.float32).reshape(-1, 3, 3)


@dataclass(frozen=True)
class Occluders:
    """The meshes of a scene.

    Attributes:
        plain: Objects that only hide.
        holdouts: Objects that cut holes into the alpha channel too.
    """

    plain: tuple[Occluder, ...] = ()
    holdouts: tuple[Occluder, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.plain or self.holdouts)


@dataclass(frozen=True)
class Region:
    """Part of the full picture that is rendered, in pixels from the lower left corner."""

    x: int
    y: int
    width: int
    height: int


def full_camera(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, width: int, height: int) -> Camera:
    """Return the scene camera for the full picture without border.

    Args:
        engine: Knows about stereo.
        depsgraph: Evaluated scene.
        width: Pixels of the full picture, percentage included.
        height: The same.

    Raises:
        ConfigError: No camera, or one that is neither perspective nor orthographic.
    """
    scene = depsgraph.scene_eval
    camera = engine.camera_override or scene.camera
    if camera is None:
        raise ConfigError("The scene has no active camera; add one or make one active.")
    camera = camera.evaluated_get(depsgraph)
    if camera.type == "CAMERA" and camera.data.type not in SUPPORTED_CAMERAS:
        raise ConfigError(f"The camera {camera.name} is panoramic; the GRMM engine takes perspective and orthographic cameras.")
    render = scene.render
    projection = camera.calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    # The engine's own matrix knows about stereo; its axes may be scaled with the camera object.
    placement = _rigid(np.array(engine.camera_model_matrix(camera), np.float64))
    result = Camera.from_opengl(np.linalg.inv(placement), np.array(projection, np.float64), width, height)
    if camera.type != "CAMERA" or not render.use_multiview:
        return result
    # Off-axis stereo shifts the lens of each eye; the projection above has the camera's own shift only.
    shift = engine.camera_shift_x(camera) - camera.data.shift_x
    return replace(result, cx=result.cx - shift * _shift_unit(camera, result, render))


def clip_range(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> tuple[float, float]:
    """Return the nearest and farthest distance that the camera sees, metres."""
    camera = (engine.camera_override or depsgraph.scene_eval.camera).evaluated_get(depsgraph)
    if camera.type != "CAMERA":
        return 1e-4, 1e10
    near = camera.data.clip_start if camera.data.type == "PERSP" else 1e-4
    return near, camera.data.clip_end


def render_region(render: bpy.types.RenderSettings, width: int, height: int) -> Region:
    """Return the border in pixels, rounded as Blender rounds it, or the full picture.

    Args:
        render: Render settings.
        width: Pixels of the full picture.
        height: The same.
    """
    if not render.use_border:
        return Region(0, 0, width, height)
    # Blender multiplies in single precision and cuts the fraction off.
    x0, x1 = (int(np.float32(edge) * np.float32(width)) for edge in (render.border_min_x, render.border_max_x))
    y0, y1 = (int(np.float32(edge) * np.float32(height)) for edge in (render.border_min_y, render.border_max_y))
    if x1 <= x0 or y1 <= y0:
        raise ConfigError("The render border is empty; draw it again (Ctrl-B in the camera view) or switch it off.")
    return Region(x0, y0, x1 - x0, y1 - y0)


def world_color(scene: bpy.types.Scene) -> np.ndarray:
    """Return the scene-linear color of the world's background, [3]; textures are not evaluated."""
    world = scene.world
    if world is None:
        return np.zeros(3, np.float32)
    tree = world.node_tree if getattr(world, "use_nodes", True) else None
    if tree is not None:
        output = tree.get_output_node("ALL")
        surface = output.inputs["Surface"] if output is not None else None
        links = surface.links if surface is not None and surface.is_linked else ()
        for link in links:
            node = link.from_node
            if node.type == "BACKGROUND":
                color, strength = node.inputs["Color"], node.inputs["Strength"]
                if not color.is_linked and not strength.is_linked:
                    return np.array(color.default_value[:3], np.float32) * np.float32(strength.default_value)
    return np.array(world.color, np.float32)


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
