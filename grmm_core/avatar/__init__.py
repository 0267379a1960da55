"""Avatars: one person as codes, shape and provenance, and the `.grmm` file that holds them.

Used by sessions, fitting, the command line and Blender. Needs numpy only.
"""

from __future__ import annotations

from .file import EXTENSION, FORMAT_VERSION, AvatarHeader, load_avatar, read_avatar_header, save_avatar
from .types import AssetReference, Avatar, Hair, PhotoRecord, Provenance

__all__ = [
    "EXTENSION",
    "FORMAT_VERSION",
    "AssetReference",
    "Avatar",
    "AvatarHeader",
    "Hair",
    "PhotoRecord",
    "Provenance",
    "load_avatar",
    "read_avatar_header",
    "save_avatar",
]
