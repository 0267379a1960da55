"""An avatar as a Python object: the only place that reads its controls and placement.

`Avatar` wraps the head object, which carries the controls (see `rig`). The render engine, the viewport, handlers, operators
and panels all go through it. Values come from the evaluated scene, so animation, drivers, constraints and library overrides
count as they do for the mesh. Imports no torch.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...grmm_core.avatar.library import LIBRARY_PREFIX
from ...grmm_core.controls.frame import Controls
from ...grmm_core.controls.names import JOINT_NAMES
from ...grmm_core.controls.table import ARRAYS, EXPRESSIONS, SLIDERS
from ...grmm_core.session import HEAD_TO_BLENDER
from ...grmm_core.session.sources import SAMPLE_PREFIX
from ..windows import redraw
from ..wrapper import ObjectWrapper
from .armature import DRIVEN_PREFIX, ROOT, local_rotation, root_offset
from .custom_properties import read_array
from .identity import DEFAULT_SOURCE, FLAME_PREFIX
from .layers import added_weights
from .saved_codes import CODES, blend_of


class Avatar(ObjectWrapper):
    """The avatar of a head object."""

    @property
    def key(self) -> int:
        """Number that identifies the head object for as long as the file is open, also across undo."""
        return self.object.session_uid

    @property
    def source(self) -> str:
        """What to open in a session: "default", "sample:SEED", "library:NAME", or the absolute path of a `.grmm` file.

        A user's FLAME head, which no session draws, is `FLAME_PREFIX` and the file's absolute path.
        """
        stored = self.object.grmm.source
        if not stored or stored == DEFAULT_SOURCE or stored.startswith((SAMPLE_PREFIX, LIBRARY_PREFIX)):
            return stored or DEFAULT_SOURCE
        if stored.startswith(FLAME_PREFIX):
            return FLAME_PREFIX + located(self.object, stored.removeprefix(FLAME_PREFIX))
        return located(self.object, stored, self.object.grmm.known_path)

    @property
    def missing_file(self) -> str:
        """One sentence if the avatar's file is not where it was, else empty; needs no runtime."""
        return missing_file(self.source) if self.has_network else ""

    @property
    def has_network(self) -> bool:
        """Whether a network draws this head; a user's FLAME head is a mesh like any other, or carries imported splats."""
        return not self.object.grmm.head_name.startswith(FLAME_PREFIX)

    @property
    def armature(self) -> bpy.types.Object | None:
        """The armature that deforms the head, or None where it was removed."""
        for modifier in self.object.modifiers:
            if modifier.type == "ARMATURE" and modifier.object is not None:
                return modifier.object
        return None

    @property
    def place_in_rig(self) -> Matrix:
        """Where the head object is in its armature: at its origin, until *Apply* puts the armature's place into its bones."""
        obj = self.object
        if obj.parent is None or obj.parent != self.armature:
            return Matrix()
        return obj.matrix_parent_inverse @ obj.matrix_basis

    @property
    def root(self) -> bpy.types.Object:
        """What is moved to move the avatar: the armature, or the head where that was removed."""
        return self.armature or self.object

    @property
    def bones(self) -> Mapping[str, bpy.types.PoseBone]:
        """The bones that animators turn, by name; none where the armature was removed."""
        return {} if self.armature is None else self.armature.pose.bones

    @property
    def mesh_owner(self) -> bpy.types.Object | None:
        """The head whose properties drive the mesh's shape keys: another one for a linked duplicate, None where none does."""
        keys = self.object.data.shape_keys
        data = keys.animation_data if keys is not None else None
        for curve in data.drivers if data is not None else ():
            for variable in curve.driver.variables:
                return variable.targets[0].id
        return None

    def controls(self, depsgraph: bpy.types.Depsgraph | None = None) -> Controls:
        """Return the controls of the current frame, not validated.

        The pose comes from the posed bones, whatever moves them; what expressions add to them is taken off again, since
        `resolve` adds it.

        Args:
            depsgraph: Evaluated scene; the context's when None.
        """
        depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
        obj = self.object.evaluated_get(depsgraph)
        result = Controls()
        added = added_weights(obj)
        weights = [obj.get(control.name, control.rest) + added.get(control.name, 0.0) for control in EXPRESSIONS]
        result.aligned = np.array(weights, np.float32)
        for control in ARRAYS:
            array = read_array(obj, control.name)
            blended = control.name in CODES
            setattr(result, control.field, array + blend_of(obj, control.name, array.size) if blended else array)
        for control in SLIDERS:
            setattr(result, control.field, float(obj.get(control.name, control.rest)))
        result.pose = self._pose(depsgraph)
        return result

    def tag_edited(self) -> None:
        """Have Blender evaluate the avatar and draw it again after its properties or bones were set from Python."""
        for obj in (self.object, self.armature):
            if obj is not None:
                obj.update_tag()
        redraw("VIEW_3D", "PROPERTIES")

    def array(self, name: str, depsgraph: bpy.types.Depsgraph | None = None) -> np.ndarray:
        """Return one of the arrays of controls, empty where the head has none; not validated."""
        return read_array(self.object.evaluated_get(depsgraph or bpy.context.evaluated_depsgraph_get()), name)

    def model_to_world(self, depsgraph: bpy.types.Depsgraph | None = None) -> np.ndarray:
        """Return head space (metres, y up, face towards +z) to Blender's world, [4, 4] float64.

        The root bone's rotation is a control; its translation is part of the placement.

        Args:
            depsgraph: Evaluated scene; the context's when None.
        """
        depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
        rig = self._evaluated_armature(depsgraph)
        # not the head's own world matrix, which Blender does not keep up to date while the head is hidden
        placed = self.object.evaluated_get(depsgraph).matrix_world if rig is None else rig.matrix_world @ self.place_in_rig
        return self._placement(np.array(placed, np.float64), rig)

    def instance_to_world(self, matrix_world: Matrix, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
        """Return head space to world for an instance of the head object, [4, 4]: see `scene.walk`."""
        return self._placement(np.array(matrix_world, np.float64), self._evaluated_armature(depsgraph))

    def _placement(self, matrix_world: np.ndarray, rig: bpy.types.Object | None) -> np.ndarray:
        matrix = matrix_world @ HEAD_TO_BLENDER
        root = rig.pose.bones.get(ROOT) if rig is not None else None
        if root is not None and root.parent is not None:
            offset = np.eye(4)
            offset[:3, 3] = root_offset(root) / self.place_in_rig.median_scale
            matrix = matrix @ offset
        return matrix

    def _evaluated_armature(self, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object | None:
        rig = self.armature
        return None if rig is None else rig.evaluated_get(depsgraph)

    def _pose(self, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
        """XYZ Euler angles in radians of the five joints, without what expressions add, [5, 3]."""
        pose = np.zeros((len(JOINT_NAMES), 3), np.float32)
        rig = self._evaluated_armature(depsgraph)
        if rig is None:
            return pose
        for joint, name in enumerate(JOINT_NAMES):
            bone = rig.pose.bones.get(name)
            if bone is None or bone.parent is None:
                continue
            driven = rig.pose.bones.get(DRIVEN_PREFIX + name)
            pose[joint] = local_rotation(bone).to_euler("XYZ")
            if driven is not None:
                pose[joint] -= np.array(driven.rotation_euler, np.float32)
        return pose


def active_object(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the active object; None also where the context has none, as while a file is being opened."""
    return getattr(context, "object", None)


def is_avatar(obj: bpy.types.Object | None) -> bool:
    """Whether an object is the head of an avatar."""
    return obj is not None and obj.type == "MESH" and obj.grmm.is_avatar


def avatar_of(obj: bpy.types.Object | None) -> Avatar | None:
    """Return the avatar that an object belongs to: its head, the armature of one, or the curves that are its hair."""
    if is_avatar(obj):
        return Avatar(obj)
    if obj is not None and obj.type == "ARMATURE":
        for child in obj.children:
            if is_avatar(child) and Avatar(child).armature == obj:
                return Avatar(child)
    if obj is not None and obj.type == "CURVES":
        head = obj.data.surface
        if is_avatar(head) and head.grmm.hair.curves == obj:
            return Avatar(head)
    return None


def locked_to_rig(selected: Iterable[bpy.types.Object]) -> bpy.types.Object | None:
    """Return the rig to move instead where nothing but locked heads is selected, whose own channels do not move; else None."""
    objects = list(selected)
    rigs = [Avatar(obj).armature if is_avatar(obj) and all(obj.lock_location) else None for obj in objects]
    return rigs[0] if rigs and all(rig is not None and rig not in objects for rig in rigs) else None


def library_of(obj: bpy.types.Object) -> bpy.types.Library | None:
    """The library whose folder relative names of an object start from: for an override that of what it overrides."""
    while obj.override_library is not None and obj.override_library.reference is not None:
        obj = obj.override_library.reference
    return obj.library


def located(obj: bpy.types.Object, stored: str, known: str = "") -> str:
    """The absolute path of a file that an object names.

    Args:
        obj: Original data.
        stored: As `stored_path` returned it.
        known: Where the file once was, for an object that came from a file elsewhere, whose folder the relative name meant.
    """
    path = bpy.path.abspath(stored, library=library_of(obj))
    lost = stored.startswith("//") and not Path(path).exists()
    return known if lost and known and Path(known).exists() else path


def stored_path(path: str, relative: bool = True, obj: bpy.types.Object | None = None) -> str:
    """What an object that is given or new keeps for a file: relative where that is wanted, and its .blend file has a place."""
    library = None if obj is None else library_of(obj)
    if not relative or (library is None and not bpy.data.is_saved):
        return path
    try:
        return bpy.path.relpath(path, start=None if library is None else str(Path(bpy.path.abspath(library.filepath)).parent))
    except ValueError:  # another drive on Windows
        return path


def missing_file(source: str) -> str:
    """Return one sentence if a source, as `Avatar.source` returns it, is a file that is not there, else an empty string."""
    if source == DEFAULT_SOURCE or source.startswith((SAMPLE_PREFIX, LIBRARY_PREFIX)) or Path(source).exists():
        return ""
    return f"{source} does not exist; choose the file again with Relink Avatar in the GRMM tab."
