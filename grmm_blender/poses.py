"""Poses as assets: actions over a head's expression properties, with catalogues, tags and thumbnails.

A pose holds a value for each control that it sets. Poses of the library set all named expressions, so that applying one
replaces the expression; they also work as plain actions in the animation editors. Called by the pose operators.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from ..grmm_core.controls.control import mirrored
from ..grmm_core.controls.table import CONTROLS, EXPRESSIONS, REGIONS
from ..grmm_core.files.access import atomic_write_bytes
from .rig.avatar import Avatar
from .rig.custom_properties import controls_of, property_path

TAG = "grmm"
KEY = "grmm_pose"  # custom property of an action: the named expression that it was made from
CATALOGUE_FILE = "blender_assets.cats.txt"
CATALOGUE_ROOT = "GRMM Expressions"
OWN = "Own"
THUMBNAIL = 128  # pixels
_NAMESPACE = uuid.UUID("5bd0a9b0-6d8b-5f0e-9b39-6a6d6d726700")  # any constant: catalogues keep their ids in every file
_PATH = re.compile(r'^\["([^"]+)"\]$')
_HEADER = b"# This is an Asset Catalog Definition file for Blender.\n\nVERSION 1\n\n"

Values = dict[tuple[str, int], float]
"""Control and index to value; the index of a single control is 0."""


def expression_values(name: str) -> Values:
    """Return the pose of one named expression at full strength, everything else at rest."""
    return {(other.name, 0): float(other.name == name) for other in EXPRESSIONS}


def present_values(avatar: Avatar) -> Values:
    """Return what an avatar's face does now: single controls, and the coefficients that are not zero."""
    head = avatar.object
    values: Values = {}
    for control in controls_of(head):
        if control.in_poses and control.size:
            values |= {(control.name, index): value for index, value in enumerate(head[control.name].to_list()) if value}
        elif control.in_poses:
            values[control.name, 0] = float(head[control.name])
    return values


def mirror(values: Values) -> Values:
    """Return a pose with its sides exchanged; coefficients of arrays stay."""
    return {(mirrored(name), index): value for (name, index), value in values.items()}


def make_pose(title: str, values: Values, key: str = "") -> bpy.types.Action:
    """Return a pose as an asset, written into the one with the same key or title if there is one.

    Args:
        title: Name of the asset.
        values: What it sets.
        key: Named expression that it was made from.
    """
    action = find_pose(title, key)
    if action is None:
        action = bpy.data.actions.new(title)
    for curves in _bags(action):
        curves.fcurves.clear()
    slot = action.slots[0] if action.slots else action.slots.new("OBJECT", "Head")
    layer = action.layers[0] if action.layers else action.layers.new("Pose")
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    bag = strip.channelbag(slot, ensure=True)
    for (name, index), value in values.items():
        curve = bag.fcurves.new(property_path(name), index=index)
        curve.keyframe_points.insert(1.0, value)
    if key:
        action[KEY] = key
    _describe(action, key)
    return action


def find_pose(title: str, key: str = "") -> bpy.types.Action | None:
    """Return the local pose of a key, else of a title."""
    for action in local_poses():
        if (action.get(KEY, "") == key) if key else (action.name == title and KEY not in action):
            return action
    return None


def local_poses() -> Iterator[bpy.types.Action]:
    """Yield the poses of this file in the order of their names."""
    for action in bpy.data.actions:
        if action.library is None and action.asset_data is not None and TAG in action.asset_data.tags:
            yield action


def read_pose(action: bpy.types.Action) -> Values:
    """Return what a pose sets: the first key of each curve of a head's control; other curves are passed over."""
    values: Values = {}
    for bag in _bags(action):
        for curve in bag.fcurves:
            match = _PATH.match(curve.data_path)
            if match and len(curve.keyframe_points):
                values[match.group(1), curve.array_index] = curve.keyframe_points[0].co[1]
    return values


def apply_values(avatar: Avatar, values: Values, amount: float, add: bool) -> list[str]:
    """Move an avatar's controls towards a pose, or add it; returns the names of the controls that the pose sets.

    Args:
        avatar: The avatar.
        values: The pose.
        amount: 0 leaves everything, 1 is the pose.
        add: Add the pose to the present expression instead of replacing it.
    """
    head = avatar.object
    names = []
    posed = {control.name: control for control in controls_of(head) if control.in_poses}
    arrays = {name: head[name].to_list() for name, control in posed.items() if control.size}
    for (name, index), value in values.items():
        if name not in posed or (name in arrays and index >= len(arrays[name])):
            continue  # a pose of another head model
        old = arrays[name][index] if name in arrays else head[name]
        new = old + amount * (value if add else value - old)
        limits = posed[name].limits
        new = min(max(new, limits.low), limits.high)
        if name in arrays:
            arrays[name][index] = new
        else:
            head[name] = new
        names.append(name)
    for name, array in arrays.items():
        if name in names:
            head[name] = array
    return list(dict.fromkeys(names))


def set_thumbnail(action: bpy.types.Action, picture: np.ndarray) -> None:
    """Give an asset its thumbnail: display sRGB with straight alpha, [H, W, 4], top row first."""
    preview = action.preview_ensure()
    preview.image_size = (picture.shape[1], picture.shape[0])
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(picture[::-1], np.float32).reshape(-1))


def catalogue_of(key: str) -> str:
    """Return the catalogue path of a named expression, or of poses that the user saved."""
    return f"{CATALOGUE_ROOT}/{CONTROLS[key].region if key in CONTROLS else OWN}"


def catalogue_id(path: str) -> str:
    """Return the identifier of a catalogue; always the same for the same path."""
    return str(uuid.uuid5(_NAMESPACE, path))


def write_catalogues(folder: Path) -> bool:
    """Add the catalogues to a folder's definition file, keeping all others; returns whether it had to be changed.

    Raises:
        FileAccessError: The file cannot be written.
    """
    path = folder / CATALOGUE_FILE
    content = path.read_bytes() if path.exists() else _HEADER
    lines = b""
    for catalogue in [CATALOGUE_ROOT, *(f"{CATALOGUE_ROOT}/{region}" for region in (*REGIONS, OWN))]:
        if catalogue_id(catalogue).encode() not in content:
            lines += f"{catalogue_id(catalogue)}:{catalogue}:{catalogue.replace('/', '-')}\n".encode()
    if not lines:
        return False
    atomic_write_bytes(path, content + (b"" if content.endswith(b"\n") else b"\n") + lines)
    return True


def _describe(action: bpy.types.Action, key: str) -> None:
    if action.asset_data is None:
        action.asset_mark()
    data = action.asset_data
    data.description = CONTROLS[key].description if key in CONTROLS else "Expression saved from an avatar"
    data.catalog_id = catalogue_id(catalogue_of(key))
    data.author = ""
    tags = [TAG, "expression"]
    if key in CONTROLS:
        control = CONTROLS[key]
        tags += [control.region, *(word for word in control.label.split() if word in ("Left", "Right"))]
    for tag in tags:
        if tag not in data.tags:
            data.tags.new(tag)


def _bags(action: bpy.types.Action) -> Iterator[bpy.types.ActionChannelbag]:
    for layer in action.layers:
        for strip in layer.strips:
            yield from strip.channelbags
