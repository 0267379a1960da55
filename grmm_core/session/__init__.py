"""Sessions: open, deform and render avatars, in this process or in a worker process (see `api`).

`create_session` chooses the implementation. Importing this package loads numpy and nothing heavier; torch is loaded by
`LocalSession` in the process that runs the model.
"""

from __future__ import annotations

from .api import (
    EMPTY_DEPTH,
    HEAD_TO_BLENDER,
    MAX_LOD,
    PASS_NAMES,
    AvatarInfo,
    CancelCheck,
    Deformation,
    GaussianArrays,
    Instance,
    RenderOptions,
    Session,
    SessionStatus,
)

__all__ = [
    "EMPTY_DEPTH",
    "HEAD_TO_BLENDER",
    "MAX_LOD",
    "PASS_NAMES",
    "AvatarInfo",
    "CancelCheck",
    "Deformation",
    "GaussianArrays",
    "Instance",
    "RenderOptions",
    "Session",
    "SessionStatus",
]
