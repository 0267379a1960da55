"""Avatars from photos in Blender: the job in its own process, the scene's settings, the panel.

``job``         runs `grmm fit` in the interpreter that has torch; knows no bpy
``settings``    photos, choices and state, kept on the window manager
``watch``       the timer that follows the job and puts the finished avatar into the scene
``provenance``  the sentence on what an avatar was made from; knows no bpy
``panel``       the sidebar panel
"""

from __future__ import annotations

from . import panel, settings, watch

CLASSES = (*settings.CLASSES, *panel.CLASSES)
PARTS = (settings, watch)
