"""Helpers for scripts about the rig: heads with random controls, evaluated meshes, what the core makes of these controls."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np
from render_support import unpainted, use_weights
from support import empty_scene, module

SEED = 3
POSED = ("root", "neck", "jaw", "left_eye", "right_eye")


def new_head(weights: str = "", seed: int = SEED, painted: bool = False) -> Any:
    """Add a random person of the weights, or the default head without a model, which may be `unpainted`; returns its Avatar."""
    if weights:
        use_weights(weights)
    with contextlib.nullcontext() if painted else unpainted():
        bpy.ops.grmm.add_head(**({"person": "RANDOM", "seed": seed} if weights else {}))
    return module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)


def fresh_head(weights: str = "", seed: int = SEED, painted: bool = False) -> Any:
    """As `new_head`, in an empty file."""
    empty_scene()
    return new_head(weights, seed, painted)


def without_detail(avatar: Any) -> Any:
    """Show the head model alone on the mesh."""
    avatar.object.grmm.live_detail = False
    update(avatar)
    return avatar


def update(avatar: Any) -> None:
    """Evaluate after properties were set from Python."""
    avatar.object.update_tag()
    avatar.armature.update_tag()
    bpy.context.view_layer.update()


def randomise(avatar: Any, generator: np.random.Generator, shape: float = 1.0) -> None:
    """Set every control to something that a face could do, all at once."""
    head, names = avatar.object, module("grmm_core.controls.names").ALIGNED_NAMES
    for name in names:
        head[name] = float(generator.uniform(-0.1, 0.5))
    head["expression"] = generator.uniform(-0.3, 0.3, len(head["expression"])).tolist()
    head["shape"] = (generator.normal(size=len(head["shape"])) * shape).clip(-3, 3).tolist()
    for code in ("z_id", "z_exp"):
        head[code] = generator.normal(size=len(head[code])).tolist()
    head["residual_strength"] = float(generator.uniform(0.3, 1.0))
    for name in POSED:
        avatar.armature.pose.bones[name].rotation_euler = generator.uniform(-0.3, 0.3, 3)
    update(avatar)


def mesh_of(avatar: Any) -> np.ndarray:
    """Evaluated vertices of the head object in head axes, metres, [V, 3]."""
    mesh = avatar.object.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.attributes["position"].data.foreach_get("vector", flat)
    points = flat.reshape(-1, 3)
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], 1)


def core_mesh(avatar: Any, controls: Any = None, displacement: np.ndarray | None = None) -> np.ndarray:
    """What the core's head model makes of an avatar's controls, with a given displacement or none, [V, 3]."""
    controls = controls or avatar.controls()
    identity = module("grmm_blender.rig.identity").read_identity(avatar.source)
    gain = module("grmm_core.head").arkit_gain(identity.head, identity.shape)
    resolved = module("grmm_core.controls.frame").resolve(controls, identity.head, gain)
    shape = identity.shape.copy()
    shape[: controls.shape.size] += controls.shape
    return identity.head.vertices(shape, resolved.expression, resolved.pose, displacement)


def model_mesh(avatar: Any, controls: Any = None) -> np.ndarray:
    """What the session makes of an avatar's controls, with learned detail, [V, 3]."""
    host = module("grmm_blender.session_host")
    opened = host.open_avatar(avatar.source)
    return host.get_session().deform(opened.id, controls or avatar.controls()).vertices


def largest(difference: np.ndarray) -> float:
    """Largest absolute value, NaN if there is one, as a number that JSON takes."""
    return float(np.abs(difference).max())


def each_alone(avatar: Any, names: Iterable[str]) -> dict[str, list[float]]:
    """Set one control after the other to 1: by how much the mesh is off, and by how much it moves, metres."""
    found, neutral = {}, mesh_of(avatar)
    for name in names:
        avatar.object[name] = 1.0
        update(avatar)
        found[name] = [largest(mesh_of(avatar) - core_mesh(avatar)), largest(mesh_of(avatar) - neutral)]
        avatar.object[name] = 0.0
    return found
