"""What helps to make pictures with avatars: composites, pose library, turntables, contact sheets, presets, menus, translations.

One entry of the extension's module list for all of them; each topic is a module of its own, in the order of registration.
"""

from __future__ import annotations

from ..operators import composite as composite_operators
from . import composite

_TOPICS = (composite, composite_operators)

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
