"""A progress bar in a panel, for all work that takes a while."""

from __future__ import annotations

import bpy

from ..grmm_core.jobs.progress import Progress
from ..grmm_core.jobs.stages import JobStages


def draw_progress(layout: bpy.types.UILayout, progress: Progress, stages: JobStages) -> None:
    """Draw how far a piece of work is, what is being done, and how long it will take."""
    layout.progress(factor=progress.fraction, text=progress.text(stages))
