"""Objects from other projects' avatars, driven by the controls that our own heads have, as far as their rigs allow.

LAM's mesh is the cloud: its vertices are the Gaussians, and properties with ARKit's names drive its shape keys. CAP4D's splats
ride on a mesh that plays the file's frames. GaussianAvatars' splats ride on the user's FLAME head, which gets the same rig as
ours: armature, ARKit properties, FLAME's expression coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ...grmm_core.avatar import AssetReference
from ...grmm_core.controls.names import ALIGNED_NAMES
from ...grmm_core.controls.table import CONTROLS, EXPRESSION_LIMITS
from ...grmm_core.errors import FileFormatError
from ...grmm_core.formats import SplatCloud, read_avatar
from ...grmm_core.formats.avatars.binding import place_on_mesh
from ...grmm_core.formats.avatars.cap4d import AnimatedAvatar
from ...grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar
from ...grmm_core.formats.avatars.lam import LamAvatar
from ...grmm_core.performance import Performance
from ..rig.actions import ensure_bag, find_curve, linear_keys, replace_keys
from ..rig.avatar import Avatar
from ..rig.build import build_avatar
from ..rig.custom_properties import add_property, property_path
from ..rig.drivers import drive_sum
from ..rig.identity import FLAME_PREFIX, Identity, load_head
from ..rig.mesh import to_blender
from .build import SPLATS, display_name, mark_cloud, new_cloud, place_in_scene, write_points
from .pictures import picture_decoder

LAM, CAP4D, GAUSSIAN_AVATARS = "LAM", "CAP4D", "GAUSSIAN_AVATARS"
NEEDS_FLAME = (
    "{path} is a GaussianAvatars avatar, whose splats ride on the FLAME head, which may not be distributed; choose your own "
    "FLAME file (generic_model.pkl or flame2023.pkl) in the import options."
)
PERSON_SHAPE = "flame_shape"  # property of a head that carries splats: the person's own shape coefficients
_FRAME_KEY = "frame {number}"


@dataclass
class Imported:
    """What an import made.

    Attributes:
        objects: New objects; the first is the one to select.
        splats: Number of Gaussians.
        frames: Frames of animation that came along.
        track: A performance that came along and was not applied yet, or None.
        avatar: The rigged head, or None.
        warnings: Sentences for the user.
    """

    objects: list[bpy.types.Object]
    splats: int
    frames: int = 0
    track: Performance | None = None
    avatar: Avatar | None = None
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Puppet:
    """An object with ARKit properties that is no head of ours: what performances need of it.

    Attributes:
        object: Carries the properties.
        armature, bones: None, and none.
    """

    object: bpy.types.Object
    armature: None = None
    bones: Mapping[str, bpy.types.PoseBone] = field(default_factory=dict, compare=False)


def is_puppet(obj: bpy.types.Object | None) -> bool:
    """Whether an object is a cloud that expressions move."""
    return obj is not None and obj.type == "MESH" and obj.grmm_cloud.is_cloud and any(name in obj for name in ALIGNED_NAMES)


def import_file(context: bpy.types.Context, path: Path, flame: str = "", turned: bool = False) -> Imported:
    """Read a splat file or another project's avatar and add it to the scene at the cursor.

    Args:
        context: In object mode.
        path: Any file that `formats.read_avatar` takes.
        flame: The user's FLAME file, for GaussianAvatars.
        turned: Turn plain splats by half a turn about the axis through the ears: for files with the other axis up.

    Raises:
        FileFormatError, FileAccessError, BackendError: The file, or the FLAME file, cannot be used.
    """
    found = read_avatar(path, picture_decoder())
    name = display_name(path)
    if isinstance(found, SplatCloud):
        cloud = found.flipped() if turned else found
        made = Imported([new_cloud(name, cloud, path, SPLATS)], cloud.count, warnings=list(cloud.warnings))
    elif isinstance(found, LamAvatar):
        made = _add_lam(name, found, path)
    elif isinstance(found, AnimatedAvatar):
        made = _add_cap4d(name, found, path, float(context.scene.frame_start))
    else:
        made = _add_gaussian_avatar(context, name, found, path, flame)
    for obj in made.objects:
        if obj.grmm_cloud.is_cloud or obj.grmm_cloud.carries:
            obj.display_type = "BOUNDS"  # the splats are what is to be seen
    place_in_scene(context, made.objects, made.objects[0])
    return made


def triangle_mesh(name: str, vertices: np.ndarray, faces: np.ndarray | None) -> bpy.types.Mesh:
    """Return a mesh of triangles, or of points, from vertices [V, 3] with y up and faces [F, 3]."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", to_blender(vertices).ravel())
    if faces is not None and len(faces):
        corners = np.ascontiguousarray(faces, np.int32)
        mesh.loops.add(corners.size)
        mesh.polygons.add(len(corners))
        mesh.loops.foreach_set("vertex_index", corners.ravel())
        mesh.polygons.foreach_set("loop_start", np.arange(0, corners.size, 3, dtype=np.int32))
        mesh.update(calc_edges=True)
    return mesh


def _add_lam(name: str, avatar: LamAvatar, path: Path) -> Imported:
    """One object: splats on the vertices of a mesh with shape keys."""
    mesh = triangle_mesh(name, avatar.cloud.means, avatar.mesh.faces)
    write_points(mesh, avatar.cloud)
    obj = bpy.data.objects.new(name, mesh)
    mark_cloud(obj, path, LAM)
    resting = to_blender(avatar.cloud.means)
    obj.shape_key_add(name="Basis", from_mix=False).points.foreach_set("co", resting.ravel())
    unknown = []
    for morph, offsets in avatar.mesh.morphs.items():
        key = obj.shape_key_add(name=morph, from_mix=False)
        key.slider_min, key.slider_max, key.value = EXPRESSION_LIMITS.low, EXPRESSION_LIMITS.high, 0.0
        key.points.foreach_set("co", (resting + to_blender(offsets)).ravel())
        if morph not in ALIGNED_NAMES:
            unknown.append(morph)
            continue
        add_property(obj, CONTROLS[morph])
        drive_sum(key, "value", -1, obj, [property_path(morph)])
    warnings = list(avatar.cloud.warnings)
    if unknown:
        warnings.append(f"{len(unknown)} morph targets are no ARKit shapes ({unknown[0]} ...); they are plain shape keys.")
    return Imported([obj], avatar.cloud.count, warnings=warnings)


def _add_cap4d(name: str, avatar: AnimatedAvatar, path: Path, start: float) -> Imported:
    """Two objects: splats, and the mesh that carries them, which plays the file's frames one a scene frame from `start`."""
    carrier = bpy.data.objects.new(f"{name} mesh", triangle_mesh(f"{name} mesh", avatar.base, avatar.faces))
    carrier.grmm_cloud.carries = True
    if avatar.deltas:
        carrier.shape_key_add(name="Basis", from_mix=False)
        keys = carrier.data.shape_keys
        keys.use_relative = False
        times = []
        for number in range(avatar.frame_count):
            key = carrier.shape_key_add(name=_FRAME_KEY.format(number=number), from_mix=False)
            key.interpolation = "KEY_LINEAR"
            key.points.foreach_set("co", to_blender(avatar.vertices(number)).ravel())
            times.append(key.frame)
        curve = find_curve(ensure_bag(keys, name), "eval_time", 0)
        frames = start + np.arange(len(times))
        replace_keys(curve, linear_keys(frames, np.array(times)), (frames[0], frames[-1]))
    resting = place_on_mesh(avatar.cloud, avatar.base, avatar.faces)
    resting.binding = avatar.cloud.binding
    splats = new_cloud(name, resting, path, CAP4D)
    _ride(splats, carrier, carrier)
    return Imported([splats, carrier], avatar.cloud.count, frames=len(avatar.deltas), warnings=list(avatar.cloud.warnings))


def _add_gaussian_avatar(context: bpy.types.Context, name: str, avatar: GaussianAvatar, path: Path, flame: str) -> Imported:
    """A rigged FLAME head and the splats that it carries."""
    if not flame:
        raise FileFormatError(NEEDS_FLAME.format(path=path))
    reference = f"{FLAME_PREFIX}{bpy.path.abspath(flame)}"
    head = load_head(AssetReference(reference))
    track = avatar.track
    shape = np.zeros(head.shape_count, np.float32)
    offset = None
    warnings = list(avatar.cloud.warnings)
    if track is None:
        warnings.append("There is no flame_param.npz beside the splats: FLAME's mean face carries them, which may not fit.")
    else:
        warnings += track.warnings
        if track.shape is not None:
            known = min(track.shape.size, head.shape_count)
            shape[:known] = track.shape[:known]
        offset = _static_offset(track.static_offset, head.vertex_count, warnings)
    # No residual codes: this head is carried by FLAME alone.
    identity = Identity(name, head, shape, z_id_size=0, z_exp_size=0, offset=offset)
    rigged = build_avatar(context, "", identity)
    carrier = rigged.object
    carrier.grmm.head_name = reference
    carrier.grmm.live_detail = False
    carrier[PERSON_SHAPE] = shape.tolist()
    carrier.grmm_cloud.carries = True
    resting = place_on_mesh(avatar.cloud, identity.vertices, head.faces)
    resting.binding = avatar.cloud.binding
    splats = new_cloud(f"{name} splats", resting, path, GAUSSIAN_AVATARS)
    _ride(splats, carrier, rigged.armature)
    frames = 0 if track is None else track.frame_count
    return Imported([carrier, splats], avatar.cloud.count, frames, track, rigged, warnings)


def _ride(splats: bpy.types.Object, carrier: bpy.types.Object, parent: bpy.types.Object) -> None:
    splats.parent = parent
    splats.grmm_cloud.carrier = carrier
    splats.lock_location = splats.lock_rotation = splats.lock_scale = (True, True, True)


def _static_offset(values: np.ndarray | None, vertex_count: int, warnings: list[str]) -> np.ndarray | None:
    """Offsets of a track [V', 3] for a head with teeth [V, 3]; a track without teeth leaves them in place."""
    if values is None:
        return None
    rows = np.asarray(values, np.float32).reshape(-1, 3)
    if len(rows) > vertex_count:
        warnings.append(f"The track has offsets for {len(rows)} vertices and the head {vertex_count}; they were left out.")
        return None
    result = np.zeros((vertex_count, 3), np.float32)
    result[: len(rows)] = rows
    return result
