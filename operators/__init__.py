"""Blender operators, one topic a file. Each module has a tuple `CLASSES`.

``common``              what they share
``add_head``            add an avatar to the scene
``import_performance``  keyframes from ARKit JSON and Live Link Face CSV
``import_splats``       splat files and other projects' avatars
``edit``                reset, mirror, random expression and identity, independent copies
"""

from __future__ import annotations

from . import add_head, edit, import_performance, import_splats

_TOPICS = (add_head, import_performance, import_splats, edit)

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
