"""Performances from videos in Blender: the capture in a process of its own, what becomes of it, the panel.

``job``    runs `grmm track` in the interpreter that has torch; knows no bpy
``watch``  the timer that follows the job and keys the head
``panel``  progress in the sidebar
"""

from __future__ import annotations

from . import panel, watch

CLASSES = panel.CLASSES
PARTS = (watch,)
