"""Hair: a groom chosen by its picture, and its strands as Blender's curves, to comb, cut and grow."""

from __future__ import annotations

from typing import ClassVar

import bpy
import numpy as np

from ..grmm_blender import exporting, session_host
from ..grmm_blender.declare import Operator, choice, flag
from ..grmm_blender.hair.build import drawing, make_curves, worn_hair
from ..grmm_blender.hair.grooms import HAIR_ITEMS, icon_of
from ..grmm_blender.hair.swing import bake_path, hair_key, place_of_head
from ..grmm_blender.properties import wear
from ..grmm_blender.rig.avatar import Avatar, stored_path
from ..grmm_blender.scene.avatars import DrawnAvatar
from ..grmm_blender.windows import areas
from ..grmm_core.errors import ConfigError
from ..grmm_core.hair import SETTINGS
from ..grmm_core.hair.swing import SwingBake, write_bake
from ..grmm_core.session.swinging import swinging
from .common import FrameRange, Result, active_avatar, check_object_mode, polls, require
from .steps import CancelCheck, Step, SteppedOperator, Steps, Turn

SCULPT = "SCULPT_CURVES"  # Blender's mode
_SIMULATED = 0.5  # seconds of work on hair that swings between two signs of life


def _combable(context: bpy.types.Context) -> Avatar:
    """The active avatar, in object mode, if the model draws it. Raises `UnavailableError`."""
    avatar = active_avatar(context)
    require(avatar.has_network, "No network draws this head")
    check_object_mode(context)
    return avatar


class GRMM_OT_hair_as_curves(SteppedOperator, Operator):
    """Make the active avatar's hair Blender's curves and go to sculpt mode: comb, cut, grow and puff it."""

    bl_label = "Edit as Curves"
    bl_description = (
        "Make the active avatar's hair a Curves object on its head, which Blender's sculpt mode and geometry nodes change, "
        "and go to sculpt mode"
    )
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    sculpt: flag("Sculpt Mode", "Go to sculpt mode at once", default=True)
    poll = polls(_combable)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Make the curves where there are none, their places on a thread, and select them."""
        avatar = _combable(context)
        hair = avatar.object.grmm.hair
        if hair.curves is None:
            worn = worn_hair(avatar)
            if worn is None:
                raise ConfigError("This avatar's own hair is no strands; choose a groom, or None to grow hair on a bald head.")
            drawn = None
            if worn.groom is not None and len(worn.groom):
                draw = drawing(avatar, worn.groom)
                drawn = yield Step(0.1, "Laying strands on the head", lambda stopped: draw())
            hair.curves = make_curves(avatar, worn.groom, worn.settings, drawn)
            for row in SETTINGS:  # strands of its own bring settings along
                if getattr(hair, row.name) != getattr(worn.settings, row.name):
                    setattr(hair, row.name, getattr(worn.settings, row.name))
            avatar.tag_edited()
        if self.sculpt:
            for other in context.selected_objects:
                other.select_set(False)
            hair.curves.hide_set(False)
            hair.curves.select_set(True)
            context.view_layer.objects.active = hair.curves
            bpy.ops.object.mode_set(mode=SCULPT)
            for area in areas("VIEW_3D"):
                area.spaces.active.overlay.show_sculpt_curves_cage = False  # thousands of white lines over the hair's color
        return "The hair is curves"


class GRMM_OT_wear_hair(Operator):
    """Have the active avatar wear a groom of strands, whatever it wore."""

    bl_label = "GRMM Hair"

    groom: choice("Hair", "What hair the avatar wears", *HAIR_ITEMS)
    poll = polls(active_avatar)

    def execute(self, context: bpy.types.Context) -> Result:
        """Change what it wears."""
        avatar = active_avatar(context)
        wear(avatar.object.grmm.hair, self.groom)
        avatar.tag_edited()
        return {"FINISHED"}


class GRMM_OT_bake_swing(SteppedOperator, FrameRange, Operator):
    """Simulate the active avatar's hair while the animation plays, and keep it in a file beside the blend file."""

    bl_label = "Bake Swing"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    poll = polls(_combable)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Walk through the frames, simulate on a thread, then write."""
        avatar, scene, frames = _combable(context), context.scene, self.frames(context)
        hair = avatar.object.grmm.hair
        if hair.curves is not None:
            raise ConfigError("This hair is curves; simulate them in Blender, or take them out of the Hair panel.")
        path = bake_path(avatar.object.name)
        hair.swing = False  # what is baked is the hair that follows the head
        controls, places, turn = [], [], Turn()
        with exporting.kept_frame(scene):
            for found in exporting.sample_controls(avatar, scene, frames):
                controls.append(found)
                places.append(place_of_head(avatar.model_to_world(context.evaluated_depsgraph_get())))
                if turn.over():
                    yield Step(0.3 * len(controls) / len(frames), "Playing the frames")
        depsgraph = context.evaluated_depsgraph_get()
        use = DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph).hair
        rate = scene.render.fps / scene.render.fps_base
        session, info = session_host.get_session(), session_host.open_avatar(avatar.source)
        uses = swinging(session, info, use, controls, rate, places)
        rows: list[np.ndarray] = []

        def simulate(stopped: CancelCheck) -> None:
            turn = Turn(_SIMULATED)
            while len(rows) < len(frames) and not stopped() and not turn.over():
                swing = next(uses).swing
                if swing is None:
                    raise ConfigError("This hair does not swing: it is in the avatar's Gaussians; choose a groom of strands.")
                rows.append(swing)

        def write(stopped: CancelCheck) -> str:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bake(path, rows, frames[0], rate)
            return SwingBake.read(path).digest

        while len(rows) < len(frames):
            yield Step(0.3 + 0.6 * len(rows) / len(frames), "Simulating", simulate)
        digest = yield Step(0.9, "Writing", write)
        hair.swing_file, hair.swing_known = stored_path(str(path), obj=avatar.object), str(path)
        hair.swing_of, hair.swing_digest, hair.swing = hair_key(avatar.object), digest, True
        avatar.tag_edited()
        return f"Baked {len(frames)} frames of hair to {path.name}"


class GRMM_MT_add_hair(bpy.types.Menu):
    """Grooms by their pictures."""

    bl_idname = "GRMM_MT_add_hair"
    bl_label = "Hair"

    def draw(self, context: bpy.types.Context) -> None:
        """List what there is."""
        for name, label, _ in HAIR_ITEMS:
            self.layout.operator(GRMM_OT_wear_hair.bl_idname, text=label, icon_value=icon_of(name.lower())).groom = name
        self.layout.separator()
        self.layout.operator(GRMM_OT_hair_as_curves.bl_idname, icon="SCULPTMODE_HLT")


CLASSES = (GRMM_OT_hair_as_curves, GRMM_OT_wear_hair, GRMM_OT_bake_swing, GRMM_MT_add_hair)
