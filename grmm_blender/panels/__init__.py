"""Panels: the sidebar tab "GRMM" and the object data tab.

``avatar_panels``  the selected avatar: source, sliders, pose, identity, learned detail
"""

from __future__ import annotations

from .avatar_panels import CLASSES

__all__ = ["CLASSES"]
