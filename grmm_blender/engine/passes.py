"""Which passes a view layer has, what they are called, and what they need from the session.

Blender's own switches are used where there are any (Depth, Normal); the rest is in `settings.GRMM_PassSettings`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import bpy

COMBINED = "Combined"
MAX_NAME = 60  # characters; Blender cuts longer pass names
FEATURES_IN_A_PASS = 4
FEATURE_CHANNELS = 32  # the refinement network's input; weights with fewer leave the rest at zero

LightKind = Literal["diffuse", "specular", "shadow"]
Kind = Literal["combined", "depth", "mask", "avatar_mask", "hair", "raw", "normal", "features", LightKind]


@dataclass(frozen=True)
class RenderPass:
    """One pass of the render result.

    Attributes:
        kind: What it shows.
        name: Name in Blender and in files.
        channels: Channels and their letters, such as "RGBA".
        type: Blender's pass type.
        avatar: Name of the avatar (`avatar_mask`).
        group: Which four channels (`features`).
    """

    kind: Kind
    name: str
    channels: str
    type: Literal["COLOR", "VALUE", "VECTOR"]
    avatar: str = ""
    group: int = 0


SESSION_PASSES: dict[Kind, tuple[str, ...]] = {
    "combined": ("linear",),
    "depth": ("depth", "alpha"),
    "mask": ("alpha",),
    "avatar_mask": ("mask",),
    "hair": ("hair",),
    "raw": ("raw_linear",),
    "normal": ("normal",),
    "features": ("features",),
    "diffuse": ("diffuse",),
    "specular": ("specular",),
    "shadow": ("shadow",),
}
"""What `Session.render` must return for each kind."""


def layer_passes(view_layer: bpy.types.ViewLayer, avatar_names: list[str]) -> list[RenderPass]:
    """Return the passes that a view layer asks for.

    Args:
        view_layer: The view layer.
        avatar_names: Names of the scene's avatars, sorted.
    """
    passes = [RenderPass("combined", COMBINED, "RGBA", "COLOR")]
    if view_layer.use_pass_z:
        passes.append(RenderPass("depth", "Z", "Z", "VALUE"))
    extra = view_layer.grmm_passes
    if view_layer.use_pass_normal or extra.use_normal:
        passes.append(RenderPass("normal", "Normal", "XYZ", "VECTOR"))
    if extra.use_mask:
        passes.append(RenderPass("mask", "Mask", "X", "VALUE"))
        passes += [RenderPass("avatar_mask", mask_pass_name(name), "X", "VALUE", avatar=name) for name in avatar_names]
    if extra.use_hair:
        passes.append(RenderPass("hair", "Hair", "X", "VALUE"))
    if extra.use_light:
        passes.append(RenderPass("diffuse", "Diffuse", "RGB", "COLOR"))
        passes.append(RenderPass("specular", "Specular", "RGB", "COLOR"))
        passes.append(RenderPass("shadow", "Shadow", "X", "VALUE"))
    if extra.use_raw:
        passes.append(RenderPass("raw", "Raw", "RGBA", "COLOR"))
    if extra.use_features:
        passes += [
            RenderPass("features", f"Features {group:02d}", "XYZW", "VECTOR", group=group)
            for group in range(FEATURE_CHANNELS // FEATURES_IN_A_PASS)
        ]
    return passes


def mask_pass_name(avatar_name: str) -> str:
    """Return the pass name of an avatar's mask. Dots would end the layer's name inside an EXR file."""
    return f"Mask {avatar_name}".replace(".", "_")[:MAX_NAME]


def register_passes(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer,
                    avatar_names: list[str]) -> None:  # fmt: skip
    """Tell Blender which passes there will be (`RenderEngine.update_render_passes`)."""
    for item in layer_passes(view_layer, avatar_names):
        engine.register_pass(scene, view_layer, item.name, len(item.channels), item.channels, item.type)


def session_passes(items: list[RenderPass]) -> tuple[str, ...]:
    """Return the buffers to ask the session for, each once."""
    return tuple(dict.fromkeys(name for item in items for name in SESSION_PASSES[item.kind]))
