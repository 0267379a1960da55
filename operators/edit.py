"""Edit an avatar's controls: reset, mirror, random expression, random identity; repair linked duplicates.

With automatic keying on, what an operator changes is keyed, as it is for a transform in the viewport.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import bpy
import numpy as np

from ..grmm_blender.declare import Operator, choice, number, whole
from ..grmm_blender.hair.curve_sliders import copy_shared, shared_with
from ..grmm_blender.motion import face_bones
from ..grmm_blender.rig import live
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_blender.rig.build import make_independent
from ..grmm_blender.rig.custom_properties import controls_of, property_path, put_at_rest, write_array
from ..grmm_blender.rig.identity import load_head, read_identity
from ..grmm_blender.rig.saved_codes import CODES, code_properties
from ..grmm_core.avatar import AssetReference
from ..grmm_core.controls.control import Control, is_sideways, mirrored, side_of
from ..grmm_core.controls.table import EXPRESSION, EXPRESSIONS, JOINTS, REGIONS, SECTIONS, SHAPE, Z_ID
from ..grmm_core.errors import GrmmError
from ..grmm_core.session.sources import SAMPLE_PREFIX
from .common import OperatorMixin, Result, active_avatar, polls, reports_errors, require

ALL = "ALL"
_REGION_ITEMS = ((ALL, "All", "Every region"), *((name, name, f"The region {name.lower()}") for name in REGIONS))
_TOGETHER = 0.8  # chance that both sides of a random expression move alike
_RANDOM_SHAPE_COUNT = 60  # leading components: the others are too small to tell people apart


def _expressions(avatar: Avatar, region: str) -> list[Control]:
    """The named expressions of a region that an avatar has."""
    return [control for control in EXPRESSIONS if region in (ALL, control.region) and control.name in avatar.object]


class Edit(OperatorMixin):
    """What operators that change an avatar's controls share."""

    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}
    poll = polls(active_avatar)

    def finish(
        self,
        context: bpy.types.Context,
        avatar: Avatar,
        names: Iterable[str],
        bones: Iterable[str] = (),
        moved: Iterable[bpy.types.PoseBone] = (),
    ) -> Result:
        """Evaluate again, and key what changed (properties, turned bones, moved bones) where automatic keying is on."""
        avatar.tag_edited()
        if context.scene.tool_settings.use_keyframe_insert_auto:
            for name in names:
                avatar.object.keyframe_insert(property_path(name))
            for bone in bones:
                avatar.bones[bone].keyframe_insert("rotation_euler")
            for moved_bone in moved:
                moved_bone.keyframe_insert("location")
        return {"FINISHED"}


class RegionEdit(Edit):
    """Edits of named expressions, of all or of one region, which the tooltip names."""

    bl_description: str
    region: choice("Region", "Work on one region only", *_REGION_ITEMS, default=ALL)

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Say what is done, and to which region."""
        what = cls.told(properties)
        return what if properties.region == ALL else f"{what}: {properties.region.lower()} only"

    @classmethod
    def told(cls, properties: bpy.types.OperatorProperties) -> str:
        """What is done, whatever the region."""
        return cls.bl_description


class DrawsAnother(OperatorMixin):
    """Mixin of operators that draw at random: from a menu or by a button something new each time."""

    seed: whole("Seed", "Equal numbers draw the same", default=1, min=0)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Take another seed, unless one is given."""
        if not self.properties.is_property_set("seed"):
            self.seed = int(np.random.default_rng().integers(1, 1 << 20))
        return self.execute(context)


class GRMM_OT_reset(RegionEdit, Operator):
    """Set controls of the active avatar back to rest."""

    bl_label = "Reset Controls"

    what: choice(
        "Controls",
        "Which controls to reset",
        (ALL, "All", "Every control"),
        *((section.key, section.label, section.description) for section in SECTIONS),
    )

    def execute(self, context: bpy.types.Context) -> Result:
        """Reset."""
        avatar = active_avatar(context)
        head = avatar.object
        controls = [control for control in controls_of(head) if self._resets(control)]
        for control in controls:
            put_at_rest(head, control)
            for saved in list(code_properties(head, control.name)) if control.name in CODES else ():
                del head[saved]
        bones = [joint.name for joint in JOINTS if self._resets(joint) and joint.name in avatar.bones]
        for bone in bones:
            avatar.bones[bone].rotation_euler = (0.0, 0.0, 0.0)
        names = [control.name for control in controls]
        moved = face_bones.controls(avatar, set(names))
        for face_bone in moved:
            face_bone.location = (0.0, 0.0, 0.0)
        return self.finish(context, avatar, names, bones, moved)

    def _resets(self, control: Control) -> bool:
        """Whether a control is meant; a region means its expressions, and leaves what belongs to none."""
        if self.what not in (ALL, control.section):
            return False
        return control.section != "EXPRESSION" or self.region in (ALL, control.region)


class GRMM_OT_mirror(RegionEdit, Operator):
    """Swap the sides of the active avatar's expression, or copy one side to the other."""

    bl_label = "Mirror Expression"

    direction: choice(
        "Direction",
        "What to mirror; left and right are the subject's",
        ("SWAP", "Swap", "Exchange both sides; sideways movements turn round"),
        ("LEFT", "Left to Right", "Copy the subject's left side to the right"),
        ("RIGHT", "Right to Left", "Copy the subject's right side to the left"),
    )

    @classmethod
    def told(cls, properties: bpy.types.OperatorProperties) -> str:
        """The direction says it."""
        return properties.bl_rna.properties["direction"].enum_items[properties.direction].description

    def execute(self, context: bpy.types.Context) -> Result:
        """Mirror."""
        avatar = active_avatar(context)
        head = avatar.object
        names = [control.name for control in _expressions(avatar, self.region) if self._takes(control.name)]
        values = {name: head[mirrored(name)] for name in names}
        for name, value in values.items():
            head[name] = value
        bones: list[str] = []
        moved = face_bones.mirror(avatar, set(names), self.direction)
        if self.region == ALL:
            self._mirror_coefficients(avatar)
            names.append(EXPRESSION)
            bones = self._mirror_bones(avatar)
        return self.finish(context, avatar, names, bones, moved)

    def _takes(self, name: str) -> bool:
        """Whether a control gets its partner's value."""
        if self.direction == "SWAP":
            return mirrored(name) != name
        return side_of(name) == ("right" if self.direction == "LEFT" else "left")

    def _mirror_coefficients(self, avatar: Avatar) -> None:
        names = load_head(AssetReference(avatar.object.grmm.head_name)).expression_names
        values = avatar.object[EXPRESSION].to_list()
        index = {name: k for k, name in enumerate(names)}
        avatar.object[EXPRESSION] = [
            values[index.get(mirrored(name), k)] if self._takes(name) else values[k] for k, name in enumerate(names)
        ]

    def _mirror_bones(self, avatar: Avatar) -> list[str]:
        """A rotation seen in a mirror keeps its pitch and turns its yaw and roll round."""
        bones = avatar.bones
        shown = [joint.name for joint in JOINTS if joint.axes and joint.name in bones]
        taken = [name for name in shown if self.direction == "SWAP" or self._takes(name)]
        angles = {name: bones[mirrored(name)].rotation_euler.copy() for name in taken}
        for name, (x, y, z) in angles.items():
            bones[name].rotation_euler = (x, -y, -z)
        return taken


class GRMM_OT_random_expression(DrawsAnother, RegionEdit, Operator):
    """Give the active avatar a random expression, or one region of it."""

    bl_label = "Random Expression"

    amount: number("Amount", "Largest weight of an expression", default=0.7, min=0.0, max=1.0, subtype="FACTOR")
    share: number("Share", "Share of the expressions that move", default=0.15, min=0.0, max=1.0, subtype="FACTOR")

    def execute(self, context: bpy.types.Context) -> Result:
        """Draw an expression."""
        avatar = active_avatar(context)
        generator = np.random.default_rng(self.seed)
        drawn: dict[str, float] = {}
        for control in EXPRESSIONS:  # all of them, so that a seed means the same in every region
            name, partner = control.name, control.partner
            moves, weight, together = generator.random() < self.share, generator.random() * self.amount, generator.random()
            if partner in drawn and not is_sideways(name) and together < _TOGETHER:
                drawn[name] = drawn[partner]
            else:
                drawn[name] = weight if moves else 0.0
        names = [control.name for control in _expressions(avatar, self.region)]
        for name in names:
            avatar.object[name] = drawn[name]
        return self.finish(context, avatar, names)


class GRMM_OT_random_identity(DrawsAnother, Edit, Operator):
    """Give the active avatar another face by its identity controls."""

    bl_label = "Random Identity"
    bl_description = (
        "Move the active avatar's identity controls towards a random person: shape, and residual identity where a network "
        "draws the head"
    )

    amount: number("Amount", "0 is the avatar itself, 1 the random person", default=1.0, min=0.0, max=1.5, subtype="FACTOR")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Draw a person."""
        avatar = active_avatar(context)
        shape = np.zeros(len(avatar.object[SHAPE]), np.float32)
        names = [SHAPE]
        if avatar.has_network:
            # As the session draws a "sample:SEED", without asking it: it may be busy with a picture, or not be there.
            person, own = read_identity(f"{SAMPLE_PREFIX}{self.seed}"), read_identity(avatar.source)
            shape = _padded(person.shape, shape.size) - _padded(own.shape, shape.size)
            alike = set(own.weights) & set(person.weights) and len(avatar.object[Z_ID]) == person.z_id_size
            if alike and person.z_id is not None and own.z_id is not None:
                write_array(avatar.object, Z_ID, (person.z_id - own.z_id) * self.amount)
                names.append(Z_ID)
        else:
            count = min(_RANDOM_SHAPE_COUNT, shape.size)
            shape[:count] = np.random.default_rng(self.seed).standard_normal(count)
        write_array(avatar.object, SHAPE, shape * self.amount)
        return self.finish(context, avatar, names)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.pad(values, (0, size))[:size]


def _follower(context: bpy.types.Context) -> Avatar:
    """The active avatar, whose mesh or curves are another one's. Raises `UnavailableError`."""
    avatar = active_avatar(context)
    follows = avatar.mesh_owner not in (None, avatar.object) or shared_with(avatar.object) is not None
    require(follows, "This head has a mesh and hair of its own")
    return avatar


class GRMM_OT_make_independent(Operator):
    """Give this head a mesh and curves of its own, which its sliders move and not those of the head it was duplicated from."""

    bl_label = "Make Independent"

    poll = polls(_follower)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Copy the mesh, and the curves that are its hair."""
        avatar = _follower(context)
        make_independent(avatar)
        copy_shared(avatar.object)
        avatar.tag_edited()
        problem = live.limitation(avatar)
        if problem:
            raise GrmmError(problem)
        return {"FINISHED"}


CLASSES = (
    GRMM_OT_reset,
    GRMM_OT_mirror,
    GRMM_OT_random_expression,
    GRMM_OT_random_identity,
    GRMM_OT_make_independent,
)
