"""Panels: the sidebar tab "GRMM" and the object data tab.

``avatar_panels``  the selected avatar: source, sliders, pose, identity, learned detail
``splat_panels``   the selected splat cloud
"""

from __future__ import annotations

from . import avatar_panels, splat_panels

CLASSES = (*avatar_panels.CLASSES, *splat_panels.CLASSES)

__all__ = ["CLASSES"]
