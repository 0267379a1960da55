"""The panel "Performance from Video" in the sidebar: choose one, and see how far it is."""

from __future__ import annotations

import bpy

from ...grmm_core.jobs.stages import TRACK
from ..panels.twins import CATEGORY
from ..progress_bar import draw_progress
from ..width import draw_text
from . import watch


class GRMM_PT_video(bpy.types.Panel):
    """Key the active head with the performance of a face in a video."""

    bl_label = "Performance from Video"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY
    bl_order = 21
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender's form

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, job = self.layout, watch.current()
        if job is not None and job.running:
            draw_progress(layout, job.status.progress, TRACK)
            layout.operator("grmm.cancel_video", icon="CANCEL")
            return
        layout.operator("grmm.import_video", text="Import Video...", icon="FILE_MOVIE")
        layout.label(text="Only of people who agreed", icon="INFO")
        if watch.note():
            draw_text(layout, watch.note(), context)


CLASSES = (GRMM_PT_video,)
