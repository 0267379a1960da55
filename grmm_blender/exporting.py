"""From the scene to what the core's writers take: splats, meshes, performances. Called by the export operators.

Avatars are exported in their own space (head axes, y up, metres), without the placement of their object: what another program
then places. Splats carry the unrefined colors, which look right without the network.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ..grmm_core.avatar import AssetReference
from ..grmm_core.controls.frame import Controls, resolve
from ..grmm_core.controls.names import ARKIT_NAMES
from ..grmm_core.errors import ConfigError, FileAccessError, FileFormatError, ShapeError
from ..grmm_core.formats import SplatCloud, write_mesh
from ..grmm_core.formats.avatars.binding import bind_to_mesh
from ..grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, write_gaussian_avatar
from ..grmm_core.formats.avatars.lam import LamAvatar
from ..grmm_core.head import HeadModel, load_flame
from ..grmm_core.performance import Performance, to_expression
from ..grmm_core.performance.recording import record, record_expression
from ..grmm_core.session import HairUse
from ..grmm_core.session.exporting import flame_avatar, lam_avatar, morph_targets, splat_cloud
from . import session_host
from .engine.pipeline import hair_of
from .hair.read import bound_strands
from .rig.avatar import Avatar, avatar_of
from .rig.identity import FLAME_PREFIX, load_head
from .rig.mesh import gain_of
from .scene.avatars import DrawnAvatar
from .scene.clouds import clouds_in
from .scene.shot import AvatarShot
from .splats.cloud import Cloud, is_cloud, resting_positions, triangles
from .splats.rigged import PERSON_SHAPE, Puppet, is_puppet

_NEEDS_FLAME = (
    "FLAME parameters need your own FLAME file (generic_model.pkl or flame2023.pkl); choose it in the export options."
)


@dataclass(frozen=True)
class SplatOptions:
    """How splats are exported.

    Attributes:
        degree: Of the spherical harmonics, 0..3.
        lod: Level of detail: each keeps a quarter of an avatar's Gaussians.
        canonical: The resting pose and expression instead of the frame's.
        whole: Those of an avatar that are never drawn too, so that each frame of a sequence has as many.
    """

    degree: int = 1
    lod: int = 0
    canonical: bool = False
    whole: bool = False


def splat_target(obj: bpy.types.Object | None, scene: bpy.types.Scene) -> Avatar | Cloud | None:
    """Return what an object's splats are exported from: its cloud, the cloud that it carries, or its avatar."""
    if is_cloud(obj):
        return Cloud(obj)
    avatar = avatar_of(obj)
    carrier = avatar.object if avatar is not None else obj
    if carrier is not None and carrier.type == "MESH" and carrier.grmm_cloud.carries:
        return next((cloud for cloud in clouds_in(scene) if cloud.carrier == carrier), None)
    return avatar


def splats_of(target: Avatar | Cloud, depsgraph: bpy.types.Depsgraph, options: SplatOptions) -> Callable[[], SplatCloud]:
    """Return what makes the splats of the depsgraph's moment, head axes, on any thread: the model may be busy, and is slow.

    Raises:
        GrmmError: The model cannot run, or the cloud was damaged by edits; here and there.
    """
    if isinstance(target, Cloud):
        cloud = target.resting() if options.canonical else target.splats(depsgraph)
        return lambda: cloud
    controls, shot = _controls(target, depsgraph, options.canonical), _shot(target, depsgraph)
    hair, source = functools.partial(hair_of, shot, moves=not options.canonical), target.source

    def make() -> SplatCloud:
        session, opened = session_host.get_session(), session_host.open_avatar(source)
        cloud = splat_cloud(session, opened, controls, options.degree, options.lod, hair())
        return cloud if options.whole else cloud.visible()

    return make


def _shot(avatar: Avatar, depsgraph: bpy.types.Depsgraph) -> AvatarShot:
    """Copy an avatar. Raises `ShapeError` where it is to wear curves that cannot be hair; the sentence says why."""
    shot = DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph)
    if shot.note:
        raise ShapeError(shot.note)
    return shot


def hair_kept(avatar: Avatar, depsgraph: bpy.types.Depsgraph) -> Callable[[], HairUse]:
    """Return what makes the hair of an avatar for its file, on any thread: curves with what their modifiers do in this frame.

    Raises as `splats_of`.
    """
    shot = _shot(avatar, depsgraph)
    curves = avatar.object.grmm.hair.curves
    if shot.strands is not None and curves is not None:
        shot = replace(shot, strands=bound_strands(avatar.object, curves, depsgraph, shot.model_to_world))
    return functools.partial(hair_of, shot, moves=False)


def lam_of(target: Avatar | Cloud, depsgraph: bpy.types.Depsgraph, options: SplatOptions) -> Callable[[], LamAvatar]:
    """Return what makes an avatar as LAM's viewer shows it, in the pose of the depsgraph's moment. As `splats_of`."""
    if isinstance(target, Cloud):
        raise FileFormatError("LAM files are of avatars that the ARKit shapes move; select a GRMM avatar.")
    controls, shot, source = _controls(target, depsgraph, options.canonical), _shot(target, depsgraph), target.source

    def make() -> LamAvatar:
        session, opened = session_host.get_session(), session_host.open_avatar(source)
        return lam_avatar(session, opened, controls, options.lod, hair=hair_of(shot, moves=False))

    return make


def write_avatar_mesh(path: Path, avatar: Avatar, depsgraph: bpy.types.Depsgraph, canonical: bool, morphs: bool) -> int:
    """Write an avatar's mesh with the learned displacement; returns the number of morph targets.

    Args:
        path: .obj or .glb.
        avatar: Of the open head, or of a head that carries splats.
        depsgraph: Evaluated scene.
        canonical: The resting pose instead of the frame's.
        morphs: Add the 52 ARKit shapes (.glb only).

    Raises:
        GrmmError: The model cannot run, or the file cannot be written.
    """
    head = load_head(AssetReference(avatar.object.grmm.head_name))
    controls = _controls(avatar, depsgraph, canonical)
    names = ARKIT_NAMES if morphs and path.suffix.lower() == ".glb" else ()
    if avatar.object.grmm_cloud.carries:
        vertices, targets = _head_mesh(avatar, head, controls, names)
    else:
        session = session_host.get_session()
        number = session_host.open_avatar(avatar.source).id
        vertices = session.deform(number, controls).vertices
        targets = morph_targets(session, number, controls, names)
    write_mesh(path, vertices, head.faces, head.uv, head.uv_faces, targets or None)
    return len(targets)


def frames_between(start: int, end: int, step: int = 1) -> list[int]:
    """Frame numbers of an export. Raises `ConfigError` when there are none."""
    frames = list(range(start, end + 1, max(1, step)))
    if not frames:
        raise ConfigError(f"There is no frame from {start} to {end}; set the last frame after the first.")
    return frames


@contextlib.contextmanager
def kept_frame(scene: bpy.types.Scene) -> Iterator[None]:
    """Come back to the scene's frame at the end."""
    frame, part = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=part)


def sample_controls(avatar: Avatar | Puppet, scene: bpy.types.Scene, frames: list[int]) -> Iterator[Controls]:
    """Yield the controls of each frame. The scene stands at another frame afterwards (see `kept_frame`)."""
    detail = avatar.object.grmm.live_detail
    try:
        avatar.object.grmm.live_detail = False  # the model need not follow a walk through the frames
        for frame in frames:
            scene.frame_set(frame)
            depsgraph = bpy.context.evaluated_depsgraph_get()
            wrapped = avatar if isinstance(avatar, Avatar) else Avatar(avatar.object)
            yield wrapped.controls(depsgraph)
    finally:
        avatar.object.grmm.live_detail = detail


def recorded(avatar: Avatar | Puppet, controls: list[Controls], frames: list[int], fps: float) -> Performance:
    """Return sampled controls as ARKit weights with head, jaw and eye rotations, see `performance.recording.record`."""
    head = load_head(AssetReference(avatar.object.grmm.head_name)) if isinstance(avatar, Avatar) else None
    return record(controls, (np.array(frames) - frames[0]) / fps, fps, head)


def recorded_flame(avatar: Avatar, controls: list[Controls], frames: list[int], fps: float, flame: str) -> Performance:
    """Return sampled controls as FLAME's parameters.

    On a FLAME head these are its own; for a head of ours the ARKit weights are retargeted to the user's FLAME file.
    Raises `FileFormatError` where that is none; see `check_flame`.
    """
    head = flame_head(avatar)
    if head is not None:
        return record_expression(controls, (np.array(frames) - frames[0]) / fps, fps, head, gain_of(avatar.object, head))
    return to_expression(recorded(avatar, controls, frames, fps), load_flame(bpy.path.abspath(flame)))


def check_flame(performer: Avatar | Puppet, flame: str) -> Avatar:
    """Return what is to be exported with FLAME's parameters. Raises `FileFormatError` where a file of FLAME is missing."""
    if not isinstance(performer, Avatar):
        raise FileFormatError(f"{performer.object.name} has no FLAME parameters; export ARKit weights (.json or .csv).")
    if flame_head(performer) is None and not flame:
        raise FileFormatError(_NEEDS_FLAME)
    return performer


def flame_head(avatar: Avatar) -> HeadModel | None:
    """Return the FLAME head that a rig was built from, None for a head of ours."""
    name = avatar.object.grmm.head_name
    return load_head(AssetReference(name)) if name.startswith(FLAME_PREFIX) else None


def gaussian_avatar(
    avatar: Avatar, cloud: Cloud | None, track: Performance, flame: str, options: SplatOptions
) -> Callable[[], GaussianAvatar]:
    """Return what makes an avatar as GaussianAvatars store it, on any thread: bound splats and FLAME's parameters.

    Args:
        avatar: A FLAME head with its cloud, or a head of ours, which is transferred to the user's FLAME.
        cloud: The splats that a FLAME head carries, None for a head of ours.
        track: Of `recorded_flame`.
        flame: The user's FLAME file, for a head of ours.
        options: Degree and detail of the splats.

    Raises:
        GrmmError: As `recorded_flame`; the model cannot run; here and there.
    """
    if cloud is not None:
        head = load_head(AssetReference(avatar.object.grmm.head_name))
        shape, offset = carried_person(avatar, head)
        faces, resting, binding = triangles(avatar.object.data), cloud.resting(), cloud.binding()

        def bind() -> GaussianAvatar:
            bound = bind_to_mesh(resting, head.shaped(shape) + offset, faces, binding)
            return GaussianAvatar(bound, replace(track, shape=shape, static_offset=offset))

        return bind
    path, source, depsgraph = bpy.path.abspath(flame), avatar.source, bpy.context.evaluated_depsgraph_get()
    controls, shot = _controls(avatar, depsgraph, canonical=True), _shot(avatar, depsgraph)

    def make() -> GaussianAvatar:
        session, opened = session_host.get_session(), session_host.open_avatar(source)
        hair = hair_of(shot, moves=False)
        return flame_avatar(session, opened, controls, load_flame(path), track, options.degree, options.lod, hair)

    return make


def save_gaussian_avatar(folder: Path, avatar: GaussianAvatar) -> None:
    """Write `point_cloud.ply` and `flame_param.npz` into a folder, made where it is missing. Raises `FileAccessError`."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise FileAccessError(f"The folder {folder} cannot be made; choose a folder that can be written to.") from error
    write_gaussian_avatar(folder, avatar)


def carried_person(avatar: Avatar, head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the person of a head that carries splats: shape coefficients [S], and what the mesh has beyond them [V, 3]."""
    resting = resting_positions(avatar.object.data)
    vertices = np.stack([resting[:, 0], resting[:, 2], -resting[:, 1]], -1)
    stored = avatar.object.get(PERSON_SHAPE)
    shape = np.zeros(head.shape_count, np.float32)
    if stored is not None:
        known = np.array(stored.to_list(), np.float32)[: head.shape_count]
        shape[: known.size] = known
    return shape, (vertices - head.shaped(shape)).astype(np.float32)


def performer_of(obj: bpy.types.Object | None) -> Avatar | Puppet | None:
    """Return what plays a performance: an avatar, or an imported one with ARKit controls."""
    return avatar_of(obj) or (Puppet(obj) if is_puppet(obj) else None)


def _controls(avatar: Avatar, depsgraph: bpy.types.Depsgraph, canonical: bool) -> Controls:
    found = avatar.controls(depsgraph)
    if not canonical:
        return found
    return found.at_rest()


def _head_mesh(
    avatar: Avatar, head: HeadModel, controls: Controls, names: tuple[str, ...]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Mesh of a head that no network draws, and its morph targets."""
    shape, offset = carried_person(avatar, head)
    gain = gain_of(avatar.object, head)

    def posed(wanted: Controls) -> np.ndarray:
        found = resolve(wanted, head, gain)
        own = shape.copy()
        own[: wanted.shape.size] += wanted.shape
        return head.vertices(own, found.expression, found.pose, offset)

    vertices = posed(controls)
    targets = {}
    for name in names:
        raised = controls.copy()
        raised.aligned[ARKIT_NAMES.index(name)] += 1.0
        targets[name] = posed(raised) - vertices
    return vertices, targets
