"""Cloud objects from splat files. Called by the importers and by `rigged`."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import numpy as np

from ...grmm_core.formats import SplatCloud
from .cloud import HARMONIC, OPACITY, ROTATION, SCALE, TRIANGLE, to_blender_axes, write_attribute

SPLATS = "SPLATS"


def new_cloud(name: str, cloud: SplatCloud, source: str | os.PathLike[str] = "", kind: str = SPLATS) -> bpy.types.Object:
    """Return a cloud object, not yet in a scene.

    Args:
        name: Of object and mesh.
        cloud: Splats with y up. With `binding`, resting ones (see `rigged`).
        source: File it was read from, for the user's eyes.
        kind: What the file holds.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(cloud.count)
    write_points(mesh, cloud)
    mesh.update()
    obj = bpy.data.objects.new(name, mesh)
    mark_cloud(obj, source, kind)
    return obj


def mark_cloud(obj: bpy.types.Object, source: str | os.PathLike[str], kind: str) -> None:
    """Make an object whose mesh has the attributes a cloud."""
    obj.grmm_cloud.is_cloud = True
    obj.grmm_cloud.source = os.fspath(source)
    obj.grmm_cloud.kind = kind


def write_points(mesh: bpy.types.Mesh, cloud: SplatCloud) -> None:
    """Store splats in a mesh that has as many vertices."""
    placed = to_blender_axes(cloud)
    mesh.vertices.foreach_set("co", np.ascontiguousarray(placed["position"], np.float32).ravel())
    write_attribute(mesh, ROTATION, "QUATERNION", placed[ROTATION])
    write_attribute(mesh, SCALE, "FLOAT_VECTOR", cloud.scales)
    write_attribute(mesh, OPACITY, "FLOAT", cloud.opacities)
    for k in range(cloud.sh.shape[1]):
        write_attribute(mesh, f"{HARMONIC}{k}", "FLOAT_VECTOR", cloud.sh[:, k])
    if cloud.binding is not None:
        write_attribute(mesh, TRIANGLE, "INT", cloud.binding)


def place_in_scene(context: bpy.types.Context, objects: list[bpy.types.Object], active: bpy.types.Object) -> None:
    """Link new objects, put those without a parent at the 3D cursor, and select the active one."""
    collection = context.collection or context.scene.collection
    for obj in objects:
        if not obj.users_collection:
            collection.objects.link(obj)
        if obj.parent is None:
            obj.location = context.scene.cursor.location
    for other in context.selected_objects:
        other.select_set(False)
    active.select_set(True)
    context.view_layer.objects.active = active


def display_name(path: str | os.PathLike[str]) -> str:
    """Name of an imported object: that of its file, or of its folder where the file's name says nothing."""
    path = Path(path)
    stem = path.name if path.is_dir() else path.stem
    return path.parent.name if stem in ("point_cloud", "meta") and path.parent.name else stem
