"""Panels: the sidebar tab "GRMM" and the object data tab.

``avatar_panels``      the selected avatar: source, pose, identity, learned detail
``expression_panels``  the named expressions by region: search, favourites, edits
``favourites``         controls with a star
``sliders``            rows of controls, which both draw
``twins``              one content, two places
``look_panels``        the selected avatar's hair and light
``splat_panels``       the selected splat cloud
``picture_panels``     pose library and presets, composite, turntable, contact sheet; presets above the engine's settings
"""

from __future__ import annotations

from . import avatar_panels, expression_panels, look_panels, picture_panels, splat_panels

CLASSES = (
    *avatar_panels.AVATAR, *splat_panels.CLASSES, *expression_panels.CLASSES, *avatar_panels.SECTION_PANELS,
    *look_panels.CLASSES, *picture_panels.CLASSES,
)  # fmt: skip


PARTS = (expression_panels, picture_panels)
