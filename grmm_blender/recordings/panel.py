"""The panel "Performance from Recording" in the sidebar: choose a video or a voice, and see how far it is."""

from __future__ import annotations

import bpy

from ..panels.twins import CATEGORY
from ..progress_bar import draw_progress
from ..width import draw_text
from . import watch


class GRMM_PT_recording(bpy.types.Panel):
    """Key the active head with the performance of a face in a video, or let it speak with a recorded voice."""

    bl_label = "Performance from Recording"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY
    bl_order = 21
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender's form

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, job = self.layout, watch.current()
        if job is not None and job.running:
            draw_progress(layout, job.status.progress, job.STAGES)
            layout.operator("grmm.cancel_recording", icon="CANCEL")
            return
        layout.operator("grmm.import_video", text="Import Video...", icon="FILE_MOVIE")
        layout.operator("grmm.import_voice", text="Import Voice...", icon="FILE_SOUND")
        layout.label(text="Only of people who agreed", icon="INFO")
        if watch.note():
            draw_text(layout, watch.note(), context)


CLASSES = (GRMM_PT_recording,)
