"""What a viewport shows as Gaussians: avatars and splat clouds as plain values, and their Gaussians in the world.

`DrawnScene` is used on the main thread, `world_gaussians` and `small_picture` on any.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import NamedTuple

import bpy
import numpy as np

from ...grmm_core.errors import GrmmError
from ...grmm_core.geometry.camera import Camera
from ...grmm_core.light.lamps import Lighting
from ...grmm_core.light.rough import evened, rough_normals, roughly_lit
from ...grmm_core.light.shading import Response
from ...grmm_core.session import CloudArrays, RenderOptions
from ...grmm_core.session.harmonics import harmonic_basis
from ...grmm_core.splat.compensation import FINEST, unresolved, widened
from ...grmm_core.splat.rules import DILATION, NEAR
from ...grmm_core.splat.types import GaussianArrays
from .. import session_host
from ..engine.pipeline import PLAYED_STRANDS, hair_of, open_instances
from ..scene.lights import LightReader
from ..scene.meshes import SOLID_DISPLAYS, drawn_triangles
from ..scene.shot import AvatarShot
from ..scene.walk import Drawn, walk
from . import studio_light
from .arrays import Picture, WorldGaussians

HEAD_CENTRE = np.zeros(3)  # what a view direction points from, head space
PICTURE_PIXELS = 320 * 240  # of small pictures
REACH = 0.26  # metres around a head's origin within which its bust and hair are
ORTHO_SETBACK = 100.0  # metres: an orthographic view sees what is behind its plane too
_EDIT_MODES = {"EDIT", "SCULPT", "VERTEX_PAINT", "WEIGHT_PAINT", "TEXTURE_PAINT"}
_SAME_STEP = 1e-5  # metres, and of the axes of a rotation
_CHUNK = 1 << 17  # Gaussians whose harmonics are evaluated at once: bounds memory


@dataclass(frozen=True)
class ViewportShot:
    """What one viewport shows.

    Attributes:
        shots: Avatars and clouds.
        meshes: World triangles of each of their meshes that Blender draws too, [T, 3, 3] float64. Splats hide these.
        message: One sentence about what cannot be shown, or empty.
    """

    shots: tuple[AvatarShot, ...] = ()
    meshes: tuple[np.ndarray, ...] = ()
    message: str = ""


class DrawnScene:
    """What a depsgraph shows until its next change, walked once and read once for all viewports."""

    def __init__(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Walk over the scene; nothing is copied before a viewport shows it."""
        self._depsgraph = depsgraph
        self._lights = LightReader()
        self._drawn = walk(depsgraph, lambda instance, _: self._lights.visit(instance))
        self._shots: dict[Drawn, AvatarShot | GrmmError] = {}
        self._triangles: dict[bpy.types.Object, tuple[np.ndarray, ...]] = {}

    def in_viewport(self, space: bpy.types.SpaceView3D, use_meshes: bool = True) -> ViewportShot:
        """Return what a viewport shows, with or without meshes. Objects that are being edited are left as meshes."""
        shots: list[AvatarShot] = []
        meshes: dict[bpy.types.Object, tuple[np.ndarray, ...]] = {}
        message = ""
        for drawn in self._drawn:
            if not _is_visible(drawn.object, space):
                continue
            shot = self._shot(drawn)
            try:
                if not isinstance(shot, GrmmError):
                    shot = studio_light.lit_in(space.shading, shot, lambda: self._lighting)
            except GrmmError as error:
                shot = error
            if isinstance(shot, GrmmError):
                message = str(shot)
                continue
            message = shot.note or message
            shots.append(_without_curves(shot, drawn, space))
            if use_meshes:
                meshes |= {mesh: self._surface(mesh) for mesh in drawn.meshes if _is_visible(mesh, space)}
        return ViewportShot(tuple(shots), tuple(part for parts in meshes.values() for part in parts), message)

    def _shot(self, drawn: Drawn) -> AvatarShot | GrmmError:
        if drawn not in self._shots:
            try:
                shot = drawn.shot(self._depsgraph)
                self._shots[drawn] = replace(shot, response=self._lights.linked(shot.response, drawn.object))
            except GrmmError as error:
                self._shots[drawn] = error
        return self._shots[drawn]

    @functools.cached_property
    def _lighting(self) -> Lighting:
        return self._lights.lighting(self._depsgraph.scene_eval, ())

    def _surface(self, mesh: bpy.types.Object) -> tuple[np.ndarray, ...]:
        """World triangles of a mesh that the viewport draws as a surface, or nothing."""
        if mesh not in self._triangles:
            found = drawn_triangles(mesh, self._depsgraph)
            self._triangles[mesh] = () if found is None else (found.placed(np.float64),)
        return self._triangles[mesh]


def moved_since(then: ViewportShot, now: ViewportShot) -> np.ndarray | None:
    """Return how everything that is shown has moved as one rigid body, [4, 4] in the world, such as a rig that is dragged.

    None where nothing has moved, where things moved apart, and where they were scaled: then only new Gaussians show it.
    """
    if then.shots is now.shots or [shot.name for shot in then.shots] != [shot.name for shot in now.shots]:
        return None
    steps = [b.model_to_world @ np.linalg.inv(a.model_to_world) for a, b in zip(then.shots, now.shots, strict=True)]
    if not steps or not all(np.allclose(step, steps[0], atol=_SAME_STEP) for step in steps):
        return None
    turned = steps[0][:3, :3]
    return steps[0] if np.allclose(turned @ turned.T, np.eye(3), atol=_SAME_STEP) else None


class Seen(NamedTuple):
    """How a camera sees an avatar, as far as its Gaussians depend on it.

    Attributes:
        direction: Unit vector towards the camera in the avatar's space, [3].
        unresolved: Close-ups: what their Gaussians are widened by, see `compensation.unresolved`.
    """

    direction: np.ndarray
    unresolved: float

    def near(self, other: Seen, degrees: float, spread: float) -> bool:
        """Whether directions differ by so many degrees at most, and spreads by a share of the widest."""
        most = DILATION**0.5 * FINEST * spread
        return angle(self.direction, other.direction) <= degrees and abs(self.unresolved**0.5 - other.unresolved**0.5) <= most


def seen_by(shot: AvatarShot, camera: Camera) -> Seen:
    """Return how a camera sees an avatar."""
    return Seen(view_direction(shot, camera), unresolved(camera.transformed(shot.model_to_world), HEAD_CENTRE))


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between unit vectors; exactly 0 for equal ones."""
    if np.array_equal(one, other):
        return 0.0
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))


def view_direction(shot: AvatarShot, camera: Camera) -> np.ndarray:
    """Unit vector from an avatar towards the camera in the avatar's space, [3]."""
    return camera.transformed(shot.model_to_world).view_direction(HEAD_CENTRE)


def world_gaussians(shot: AvatarShot, camera: Camera, lod: int) -> WorldGaussians:
    """Return an avatar's or a cloud's Gaussians with the colors that a camera sees.

    Raises:
        GrmmError: The avatar or the session cannot be used.
    """
    if shot.cloud is not None:
        arrays = _thinned(shot.cloud.arrays, lod)
        colors = _cloud_colors(arrays, camera.transformed(shot.model_to_world))
        return WorldGaussians.place(arrays.means, arrays.quats, arrays.scales, arrays.opacities, colors, shot.model_to_world)
    info = session_host.open_avatar(shot.source)
    direction = view_direction(shot, camera)
    found = session_host.get_session().gaussians(info.id, shot.controls.validate(), direction, lod, hair=hair_of(shot))
    colors = found.colors
    if shot.lighting is not None:
        colors = _lit_colors(found, shot, studio_light.in_world(shot, shot.lighting, camera.world_to_camera))
    scales, opacities = found.scales, found.opacities
    if info.antialiased and lod == 0:  # thinned out ones are wider than that, and strands, which come last, are not learned
        skin = info.gaussian_count
        wide, spread = widened(scales[:skin], unresolved(camera.transformed(shot.model_to_world), HEAD_CENTRE))
        scales = np.concatenate([wide, scales[skin:]])
        opacities = np.concatenate([opacities[:skin] * spread, opacities[skin:]])
    return WorldGaussians.place(found.means, found.quats, scales, opacities, colors, shot.model_to_world, info.antialiased)


def _lit_colors(found: GaussianArrays, shot: AvatarShot, lighting: Lighting) -> np.ndarray:
    """Colors [N, 3] of an avatar in a light of the world's axes, roughly."""
    response = shot.response or Response()
    own = lighting.without(response.unlit_by).in_space(np.linalg.inv(shot.model_to_world))
    normals = evened(found.means, found.scales, rough_normals(found.means, found.quats, found.scales))
    return roughly_lit(found.colors, normals, own, response.intensity)


def small_picture(shots: tuple[AvatarShot, ...], camera: Camera) -> Picture:
    """Return what the rasteriser makes of all of them together for a camera, in `PICTURE_PIXELS`.

    Those are spent where the heads are. Where hair reaches farther than heads do, the whole view is drawn.

    Raises:
        GrmmError: An avatar or the session cannot be used.
    """
    picture = _picture_of(shots, camera, _reached(shots, camera))
    return _picture_of(shots, camera, (0, 0, camera.width, camera.height)) if picture.is_cut else picture


def _reached(shots: tuple[AvatarShot, ...], camera: Camera) -> tuple[int, int, int, int]:
    """Left, upper, right and lower edge of the pixels where heads may be; all of them where there are clouds."""
    size = np.array([camera.width, camera.height])
    everything = 0, 0, camera.width, camera.height
    if not shots or any(shot.cloud is not None for shot in shots):
        return everything
    placed = camera.world_to_camera @ np.stack([shot.model_to_world for shot in shots])
    radius = REACH * np.linalg.norm(placed[:, :3, :3], axis=1).max(1)[:, None]  # of spheres, [A, 1]
    across, depth = placed[:, :2, 3], placed[:, 2:3, 3]
    if camera.orthographic:
        low, high = across - radius, across + radius
    elif (depth > radius + NEAR).all():
        middle, half = np.arctan2(across, depth), np.arcsin(radius / np.hypot(across, depth))
        low, high = np.tan(middle - half), np.tan(middle + half)
    else:
        return everything
    focal, centre = (camera.fx, camera.fy), (camera.cx, camera.cy)
    first = np.clip(np.floor((low * focal + centre).min(0)), 0, size - 1).astype(int)
    last = np.clip(np.ceil((high * focal + centre).max(0)), first + 1, size).astype(int)
    return int(first[0]), int(first[1]), int(last[0]), int(last[1])


def _picture_of(shots: tuple[AvatarShot, ...], camera: Camera, box: tuple[int, int, int, int]) -> Picture:
    left, upper, right, lower = box
    frame = left / camera.width, 1.0 - lower / camera.height, right / camera.width, 1.0 - upper / camera.height
    part = camera.crop(left, upper, right - left, lower - upper)
    scale = min(1.0, (PICTURE_PIXELS / (part.width * part.height)) ** 0.5)
    small = part.resized(max(1, round(part.width * scale)), max(1, round(part.height * scale)))
    setback = ORTHO_SETBACK if camera.orthographic else 0.0
    matrix = small.world_to_camera.copy()
    matrix[2, 3] += setback
    small = replace(small, world_to_camera=matrix)
    options = RenderOptions(refine=False, passes=("raw", "alpha", "depth"), strands=PLAYED_STRANDS, coarse=True)
    found = session_host.get_session().render(open_instances(shots), small, options)
    color = np.concatenate([found["raw"], found["alpha"]], -1)
    return Picture(color, np.where(found["alpha"] > 0.0, found["depth"] - setback, 0.0)[..., 0].astype(np.float32), frame)


def _thinned(arrays: CloudArrays, lod: int) -> CloudArrays:
    """Return an even part of a cloud, a quarter for each level, of larger Gaussians."""
    if not lod:
        return arrays
    step, growth = 4**lod, 2.0**lod
    return CloudArrays(
        arrays.means[::step],
        arrays.quats[::step],
        arrays.scales[::step] * np.float32(growth),
        arrays.opacities[::step],
        arrays.harmonics[::step],
    )


def _cloud_colors(arrays: CloudArrays, camera: Camera) -> np.ndarray:
    """Colors [N, 3] of a cloud as a camera in the cloud's space sees them."""
    degree = round(arrays.harmonics.shape[1] ** 0.5) - 1
    colors = np.empty((len(arrays.means), 3), np.float32)
    for start in range(0, len(colors), _CHUNK):
        part = slice(start, start + _CHUNK)
        offsets = arrays.means[part] - camera.position
        if camera.orthographic:
            offsets = np.broadcast_to(camera.forward, offsets.shape)
        basis = harmonic_basis(offsets / np.linalg.norm(offsets, axis=-1, keepdims=True).clip(1e-12), degree)  # [N, K]
        colors[part] = np.einsum("nk,nkc->nc", basis.astype(np.float32), arrays.harmonics[part]) + 0.5
    return colors.clip(0.0)


def _without_curves(shot: AvatarShot, drawn: Drawn, space: bpy.types.SpaceView3D) -> AvatarShot:
    """A shot without the strands that the viewport draws itself, as Blender's curves: nothing is to be seen twice."""
    if shot.strands is None:
        return shot
    curves = drawn.object.grmm.hair.curves
    shown = curves is not None and curves.display_type in SOLID_DISPLAYS and curves.visible_in_viewport_get(space)
    return replace(shot, strands=None) if shown else shot


def _is_visible(obj: bpy.types.Object, space: bpy.types.SpaceView3D) -> bool:
    return obj.mode not in _EDIT_MODES and obj.visible_in_viewport_get(space)
