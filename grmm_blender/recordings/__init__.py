"""Performances from recordings, videos and voices, in Blender: the work in a process of its own, what becomes of it, the panel.

``job``    runs `grmm track` or `grmm speak` in the interpreter that has their libraries; knows no bpy
``watch``  the timer that follows the job and keys the head
``panel``  progress in the sidebar
"""

from __future__ import annotations

from . import panel, watch

CLASSES = panel.CLASSES
PARTS = (watch,)
