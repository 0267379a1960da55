"""Blender operators, one topic a file. Each module has a tuple `CLASSES`.

``add_head``  add an avatar to the scene
"""

from __future__ import annotations

from . import add_head

_TOPICS = (add_head,)

CLASSES = tuple(cls for topic in _TOPICS for cls in topic.CLASSES)


def register() -> None:
    """Run the topics' own `register`, such as menu entries."""
    for topic in _TOPICS:
        if hasattr(topic, "register"):
            topic.register()


def unregister() -> None:
    """Take back `register`."""
    for topic in reversed(_TOPICS):
        if hasattr(topic, "unregister"):
            topic.unregister()
