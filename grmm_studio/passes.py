"""What a render leaves: color, alpha, depth, and on demand albedo, normals and part masks, read back as arrays. Imports bpy.

Part masks and albedo are shader outputs of their own (AOVs), so that they are smooth at edges and thin strands like the alpha.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from grmm_core.data.layers import ALBEDO, NORMAL, PART_LAYER, PARTS
from grmm_core.data.types import Picture
from grmm_core.pictures.color import linear_to_srgb

PART_OUTPUTS = tuple(f"parts{i}" for i in range((len(PARTS) + 2) // 3))
FAR = 50.0  # metres; what is farther is background


class Passes:
    """The outputs of a scene, written to a folder at each render."""

    def __init__(self, scene: bpy.types.Scene, folder: Path, layers: bool) -> None:
        self._scene, self._folder, self._layers = scene, folder, layers
        view = scene.view_layers[0]
        view.use_pass_z = True
        slots = [("rgba", "Image"), ("depth", "Depth")]
        if layers:
            view.use_pass_normal = True
            for name in (ALBEDO, *PART_OUTPUTS):
                view.aovs.add().name = name
            slots += [("normal", "Normal"), *((name, name) for name in (ALBEDO, *PART_OUTPUTS))]
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        source = tree.nodes.new("CompositorNodeRLayers")
        output = tree.nodes.new("CompositorNodeOutputFile")
        output.base_path = str(folder)
        output.format.file_format = "OPEN_EXR"
        output.format.color_mode = "RGBA"
        output.format.color_depth = "32"
        output.format.exr_codec = "NONE"
        output.file_slots.clear()
        for slot, socket in slots:
            output.file_slots.new(slot)
            tree.links.new(source.outputs[socket], output.inputs[slot])

    def render(self) -> Picture:
        """Render the scene as it is."""
        with _quiet():
            bpy.ops.render.render()
        rgba, z = self._read("rgba"), self._read("depth")[..., 0]
        alpha = np.clip(rgba[..., 3], 0.0, 1.0)
        covered = np.maximum(alpha, 1e-4)[..., None]
        color = linear_to_srgb(np.clip(rgba[..., :3] / covered, 0.0, 1.0))
        depth = np.where((alpha > 0.25) & (z < FAR), z, 0.0)
        layers = {}
        if self._layers:
            world = self._read("normal")[..., :3]
            normal = np.stack([world[..., 0], world[..., 2], -world[..., 1]], -1)  # to head space
            layers[NORMAL] = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
            layers[ALBEDO] = linear_to_srgb(np.clip(self._read(ALBEDO)[..., :3] / covered, 0.0, 1.0))
            parts = np.concatenate([self._read(name)[..., :3] for name in PART_OUTPUTS], -1)
            layers[PART_LAYER] = np.clip(parts[..., : len(PARTS)], 0, 1).transpose(2, 0, 1)
        return Picture(
            color.astype(np.float32), alpha.astype(np.float32), depth.astype(np.float32),
            {name: np.ascontiguousarray(values, np.float32) for name, values in layers.items()},
        )  # fmt: skip

    def _read(self, slot: str) -> np.ndarray:
        """Pixels [H, W, 4], first row on top."""
        image = bpy.data.images.load(str(self._folder / f"{slot}0001.exr"))
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        return pixels.reshape(height, width, 4)[::-1]


def silence_exit() -> None:
    """At the end of the process Blender reports a few bytes of its own on the standard output, after our result."""
    sys.stdout.flush()
    _flush_blender()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _flush_blender() -> None:
    """Let go what Blender's code has written but the C library still holds, as it does where the output is no terminal."""
    ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fflush(None)


@contextmanager
def _quiet() -> Iterator[None]:
    """Drop what Blender's own code writes to the standard output: the command line keeps that for results."""
    sys.stdout.flush()
    saved = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        _flush_blender()
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)
