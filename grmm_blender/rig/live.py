"""What the add-on keeps up to date on a rig: the residual shape key, the small shape components, the rest joints.

They depend on the controls in ways that drivers cannot express, or not fast enough: the learned displacement comes from the
model (eq. 11), pose correctives of FLAME are not linear in the angles, each joint is a sum over all shape coefficients, and
hundreds of shape keys that hardly move anything would take most of a frame's time. `handlers` calls `predict` before a frame
is evaluated, `update` after frame changes and edits, and `settle` where the data must be right by itself: before files and
renders. Without the add-on the file keeps the last state.

Reaches the model through `session_host`; imports no torch.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...grmm_core.avatar import AssetReference
from ...grmm_core.controls.frame import Controls, resolve
from ...grmm_core.controls.table import CONTROLS, SHAPE
from ...grmm_core.errors import GrmmError, RuntimeMissingError
from ...grmm_core.geometry.rotations import euler_to_matrix
from ...grmm_core.head import HeadModel
from .. import session_host
from .actions import action_fcurves
from .armature import joint_parents, shift_joints
from .avatar import Avatar
from .custom_properties import property_path
from .drivers import resting_pose
from .identity import load_head
from .mesh import (
    BASIS_KEY,
    RESIDUAL_KEY,
    SHAPE_REST_KEY,
    evaluated_key,
    leading_shapes,
    read_key,
    to_blender,
    write_key,
    write_offsets,
)
from .weighted_sums import RecentSums, weighted_sum

_SHAPE_PATH = property_path(SHAPE)


@dataclass
class LiveState:
    """What was last done for one avatar.

    Attributes:
        shape_for: Shape coefficients that the joints and the key of small components belong to.
        detail_for: Controls and source that the residual key holds; empty where it holds nothing, None where that is unknown.
        message: One sentence for the panel where something is wrong, else empty.
        stale: The residual key does not belong to the current controls.
        ahead: What the evaluated scene has as the key of small components while the key itself is older, [3 V]; None where they
            are the same.
        leading: Shape components with keys of their own that were last seen.
        shape_curves_of: Action, its slot and number of curves that `shape_curves` were found in.
        shape_curves: Places of the curves that animate the shape.
        recent: Sums of small components for shapes of recent frames.
    """

    shape_for: bytes | None = None
    detail_for: bytes | None = None
    message: str = ""
    stale: bool = False
    ahead: np.ndarray | None = None
    leading: np.ndarray | None = None
    shape_curves_of: tuple[int, int, int] | None = None
    shape_curves: list[int] = field(default_factory=list)
    recent: RecentSums | None = None


_states: dict[int, LiveState] = {}


def state_of(avatar: Avatar) -> LiveState:
    """Return what is known about an avatar; panels show it."""
    return _states.setdefault(avatar.key, LiveState())


def forget() -> None:
    """Forget everything: another file, or an undone edit, is there now."""
    _states.clear()


def note(avatar: Avatar, message: str) -> None:
    """Keep one sentence for panels about why the learned displacement is missing; the next change of a control tries again."""
    state = state_of(avatar)
    state.message, state.stale = message, False


def update(avatar: Avatar, depsgraph: bpy.types.Depsgraph | None = None, detail: bool = True, brief: bool = False) -> bool:
    """Bring an avatar's joints and residual key up to date with its controls.

    Args:
        avatar: The avatar.
        depsgraph: Evaluated scene to read from; the context's when None.
        detail: Also compute the learned displacement; without, the key is left as it is and marked stale.
        brief: Read only the controls that matter, for frame changes; others are not checked then.

    Returns:
        Whether anything was written. Problems do not raise, they end up in the state's message: a handler has no user to
        report to.
    """
    state = state_of(avatar)
    state.message = ""
    if avatar.object.data.shape_keys is None:
        return False
    try:
        head = load_head(AssetReference(avatar.object.grmm.head_name))
        if brief and state.detail_for == b"" and not _wants_detail(avatar, head):
            shape = avatar.array(SHAPE, depsgraph)
            if np.isfinite(shape).all():
                return _update_shape(avatar, head, shape, state) or settle(avatar, depsgraph)
        controls = avatar.controls(depsgraph).validate()
        wrote = _update_shape(avatar, head, controls.shape, state)
        wrote = settle(avatar, depsgraph if brief else None) or wrote
        return _update_detail(avatar, head, controls, state, detail) or wrote
    except RuntimeMissingError:
        state.stale = False  # nothing could compute it: the mesh is the head model alone, as the panel says
        return False
    except GrmmError as error:
        state.message = str(error)
        return False


def predict(avatar: Avatar, frame: float, depsgraph: bpy.types.Depsgraph | None) -> None:
    """Follow an animated shape before the frame is evaluated.

    `update` does it afterwards in any case, but then the mesh has to be evaluated a second time. Knows an action only; where
    other things animate the shape, `update` corrects what is written here.

    Args:
        avatar: The avatar.
        frame: Frame that is about to be evaluated, with its fraction.
        depsgraph: What is about to evaluate it; None where that is not known.
    """
    values = avatar.object.get(SHAPE)
    if values is None or avatar.object.data.shape_keys is None:
        return
    animated = _animated_shape(avatar, state_of(avatar), frame, len(values))
    if animated is None:
        return
    shape = np.array(values.to_list(), np.float32)
    shape[animated[0]] = animated[1]
    limits = CONTROLS[SHAPE].limits
    try:
        head = load_head(AssetReference(avatar.object.grmm.head_name))
    except GrmmError:
        return  # `update` reports it
    if np.isfinite(shape).all():
        _update_shape(avatar, head, shape.clip(limits.low, limits.high), state_of(avatar), depsgraph)


def _animated_shape(avatar: Avatar, state: LiveState, frame: float, count: int) -> tuple[list[int], list[float]] | None:
    """Components of the shape that the head's action animates and their values at a frame; None where it animates none.

    Finding these curves among hundreds takes longer than evaluating them, so their places are kept. Where they are not the
    right ones any more (an action edited in place), `update` sets it right.
    """
    curves = action_fcurves(avatar.object)
    if curves is None:
        return None
    data = avatar.object.animation_data
    key = (data.action.session_uid, data.action_slot_handle, len(curves))
    if state.shape_curves_of != key:
        paths = [curve.data_path for curve in curves]
        state.shape_curves_of = key
        state.shape_curves = [place for place, path in enumerate(paths) if path == _SHAPE_PATH]
    found = [curves[place] for place in state.shape_curves]
    if not found or found[0].data_path != _SHAPE_PATH:
        state.shape_curves_of = None
        return None
    found = [curve for curve in found if not curve.mute and curve.array_index < count]
    return [curve.array_index for curve in found], [curve.evaluate(frame) for curve in found]


def _update_shape(
    avatar: Avatar, head: HeadModel, shape: np.ndarray, state: LiveState, before: bpy.types.Depsgraph | None = None
) -> bool:
    """Place the joints, and write the small components, for the shape [<=S] that is added to the avatar's own.

    Args:
        avatar: The avatar.
        head: Its head model.
        shape: What is added, [<=S].
        state: Of the avatar.
        before: The depsgraph that is about to evaluate an animated shape. Writing a key has Blender copy all keys into the
            evaluated scene again, a fifth of a frame's time: then only the copy is written, and the key by `settle` later.
    """
    digest = shape.tobytes() if shape.any() else b""
    if state.shape_for == digest:
        return False
    state.shape_for = digest
    obj, rig, first = avatar.object, avatar.armature, leading_shapes(head)
    wrote = False
    if _may_write(avatar) and SHAPE_REST_KEY in obj.data.shape_keys.key_blocks:
        positions = read_key(obj.data.shape_keys.key_blocks[BASIS_KEY])
        if shape.size > first:
            positions += _small_sum(head, shape[first:], state, exact=before is None)
        # The mesh is evaluated again when one of the keys with a driver changes.
        leading, state.leading = state.leading, shape[:first]
        evaluates = before is not None and leading is not None and not np.array_equal(leading, state.leading)
        copy = evaluated_key(obj, SHAPE_REST_KEY, before) if evaluates else None
        if copy is None:
            state.ahead = None
            wrote = write_key(obj, SHAPE_REST_KEY, positions)
        else:
            copy.points.foreach_set("co", positions)
            state.ahead = positions
    if rig is not None and rig.is_editable:
        shifts = head.joint_dirs[:, :, : shape.size] @ shape + np.reshape(obj.grmm.joint_offset, (-1, 3))  # [5, 3]
        if shift_joints(rig, shifts * avatar.place_in_rig.median_scale, joint_parents(head)):
            rig.update_tag(refresh={"DATA"})
            wrote = True
    return wrote


def settle(avatar: Avatar, depsgraph: bpy.types.Depsgraph | None = None) -> bool:
    """Write the key of small components where only a copy of it was written.

    Args:
        avatar: The avatar.
        depsgraph: Leave the key as it is as long as this evaluated scene's copy is right; None writes it in any case.

    Returns:
        Whether the key was written.
    """
    state = state_of(avatar)
    positions, keys = state.ahead, avatar.object.data.shape_keys
    if positions is None or keys is None:
        return False
    if depsgraph is not None:
        copy = evaluated_key(avatar.object, SHAPE_REST_KEY, depsgraph)
        if copy is not None and np.array_equal(read_key(copy), positions):
            return False
    state.ahead = None
    key = keys.key_blocks.get(SHAPE_REST_KEY)
    if not _may_write(avatar) or key is None or len(key.points) * 3 != positions.size:
        return False
    return write_key(avatar.object, SHAPE_REST_KEY, positions)


def limitation(avatar: Avatar) -> str:
    """Return one sentence where the mesh cannot follow all controls, else an empty string; GRMM renders always follow them."""
    mesh, owner = avatar.object.data, avatar.mesh_owner
    if owner not in (None, avatar.object):
        return f"The mesh is shared with {owner.name} and follows that head; make this head independent."
    if mesh.library is not None:
        return "The mesh is linked and stays as it was saved; make a library override to animate it."
    if mesh.override_library is not None:
        return "The mesh is a library override: small shape components and learned detail stay as in the library."
    if mesh.shape_keys is None:
        return "The mesh has no shape keys any more and follows only the bones; add the head again."
    if avatar.armature is None:
        return "The armature is missing: neck, jaw and eyes cannot turn; add the head again."
    return ""


def _may_write(avatar: Avatar) -> bool:
    """Whether the keys of the head's mesh are this avatar's, and can be written at all (Blender ignores it on overrides)."""
    mesh = avatar.object.data
    return mesh.library is None and mesh.override_library is None and avatar.mesh_owner in (None, avatar.object)


@functools.lru_cache(maxsize=2)
def _small_shapes(head: HeadModel) -> np.ndarray:
    """Directions of the components without a key of their own, Blender's axes, [S', 3 V]."""
    small = np.moveaxis(head.shape_dirs[:, :, leading_shapes(head) :], 2, 0)  # [S', V, 3]
    return np.ascontiguousarray(to_blender(small).reshape(len(small), -1))


def _small_sum(head: HeadModel, weights: np.ndarray, state: LiveState, exact: bool) -> np.ndarray:
    """Offsets of the small components, Blender's axes, flat, [3 V].

    Args:
        head: Their head model.
        weights: Coefficients, [<=S'].
        state: Keeps what a frame has in common with the ones before.
        exact: Whatever was computed before, to the last bit: renders in any order must be the same.
    """
    rows = _small_shapes(head)
    if exact:
        return weighted_sum(weights, rows)
    if state.recent is None or state.recent.rows is not rows:
        state.recent = RecentSums(rows)
    return state.recent(weights)


def _update_detail(avatar: Avatar, head: HeadModel, controls: Controls, state: LiveState, detail: bool) -> bool:
    """Write what the model and the pose correctives add to the unposed mesh into the residual key."""
    obj = avatar.object
    wanted = _wants_detail(avatar, head)
    if not _may_write(avatar):
        state.stale = False
        return False
    digest = _detail_key(avatar, controls) if wanted else b""
    if state.detail_for == digest:
        state.stale = False
        return False
    if not detail:
        state.stale = True
        return False
    offsets = _pose_correctives(avatar, head, controls)
    if obj.grmm.live_detail:
        session = session_host.get_session()
        offsets = offsets + session.deform(session_host.open_avatar(avatar.source).id, controls).displacement
    state.detail_for, state.stale = digest, False
    settled = settle(avatar)  # what follows has Blender copy all keys
    return write_offsets(obj, RESIDUAL_KEY, to_blender(offsets).ravel()) or settled


def _wants_detail(avatar: Avatar, head: HeadModel) -> bool:
    return avatar.object.grmm.live_detail or head.posedirs is not None


def _detail_key(avatar: Avatar, controls: Controls) -> bytes:
    """What the residual key depends on."""
    return f"{avatar.source}|{avatar.object.grmm.live_detail}|".encode(errors="surrogateescape") + controls.key()


def _pose_correctives(avatar: Avatar, head: HeadModel, controls: Controls) -> np.ndarray:
    """FLAME's pose-corrective offsets, head space, metres, [V, 3]; zeros for heads without."""
    if head.posedirs is None:
        return np.zeros((head.vertex_count, 3), np.float32)
    pose = resolve(controls, head).pose + resting_pose(avatar.bones)
    feature = (euler_to_matrix(pose)[1:] - np.eye(3, dtype=np.float32)).ravel()
    return head.posedirs @ feature
