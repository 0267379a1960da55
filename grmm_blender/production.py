"""What helps to make pictures with avatars: composites, pose library, turntables, contact sheets, presets, menus, translations.

One entry of the extension's module list for all of them; each topic is a module of its own, in the order of registration.
"""

from __future__ import annotations

from ..operators import composite as composite_operators
from ..operators import contact_sheet, pose_library, turntable
from . import composite, menus, preset_menus, translations
from .panels import production as panels

_TOPICS = (composite, composite_operators, pose_library, turntable, contact_sheet, preset_menus, menus, panels, translations)

CLASSES = tuple(cls for topic in _TOPICS for cls in topic.CLASSES)


def register() -> None:
    """Run the topics' own `register`."""
    for topic in _TOPICS:
        if hasattr(topic, "register"):
            topic.register()


def unregister() -> None:
    """Take back `register`."""
    for topic in reversed(_TOPICS):
        if hasattr(topic, "unregister"):
            topic.unregister()
