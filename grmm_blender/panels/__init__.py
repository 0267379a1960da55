"""Panels: the sidebar tab "GRMM" and the object data tab.

``avatar_panels``  the selected avatar: source, sliders, pose, identity, learned detail
``sliders``        rows of sliders that both draw
``splat_panels``   the selected splat cloud
``picture_panels`` poses and presets, composite, turntable, contact sheet; presets above the engine's settings
"""

from __future__ import annotations

from . import avatar_panels, picture_panels, splat_panels

CLASSES = (*avatar_panels.CLASSES, *splat_panels.CLASSES, *picture_panels.CLASSES)

register, unregister = picture_panels.register, picture_panels.unregister

__all__ = ["CLASSES", "register", "unregister"]
