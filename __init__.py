"""GRMM for Blender: the extension's entry point.

Blender imports this module from the installed extension. The Blender half is imported inside the two functions, because
Python tools that walk the repository import this file where there is no bpy.
"""

from __future__ import annotations


def register() -> None:
    """Register every class and handler of the extension."""
    from . import grmm_blender

    grmm_blender.register()


def unregister() -> None:
    """Take everything back that `register` did and close the model's session."""
    from . import grmm_blender

    grmm_blender.unregister()
