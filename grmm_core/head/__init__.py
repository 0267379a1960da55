"""Head models: the open head, the user's FLAME, skinning.

``head_model``  `HeadModel`, FLAME's format as numpy arrays; needs numpy only
``closing``     how far blinks and lips of a person must go to shut; ``usual_face``: lips, mouths, brows of people at rest
``lash_cards``  the strips that stand for lashes, and so the edges of lids; ``lip_border``: where lips end
``skinning``    linear blend skinning as pure functions, for numpy and torch
``open_head``   the project's own head and its relation to age, gender, ethnicity and weight
``flame``       a user's FLAME file completed to a `HeadModel`; its parts are ``flame_file`` (reading without executing),
                ``flame_regions``, ``flame_teeth``, ``flame_uv`` (with ``flatten_disk``, ``mesh_topology``, ``uv_density``),
                ``flame_align`` and ``flame_arkit``
``torch_head``  batched, differentiable twin for training; imported only where torch is
"""

from __future__ import annotations

import os
from pathlib import Path

from .closing import arkit_gain
from .head_model import HeadModel
from .open_head import PeopleModel, load_open_head, load_people_model, read_head_file

FLAME_SUFFIXES = (".pkl", ".npz")

__all__ = [
    "FLAME_SUFFIXES", "HeadModel", "PeopleModel", "arkit_gain", "load_flame", "load_open_head", "load_people_model",
    "read_head",
]  # fmt: skip


def load_flame(
    path: str | os.PathLike[str],
    masks: str | os.PathLike[str] | None = None,
    landmarks: str | os.PathLike[str] | None = None,
) -> HeadModel:
    """Complete a user's FLAME file to a head model: `flame.load_flame`, whose dozen modules are imported only here."""
    from .flame import load_flame as load

    return load(path, masks, landmarks)


def read_head(path: str | os.PathLike[str]) -> HeadModel:
    """Read a head model: a file of this project's format, or a user's FLAME file (.pkl, .npz).

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Corrupt, another format, or a version that is not known.
    """
    return load_flame(path) if Path(path).suffix.lower() in FLAME_SUFFIXES else read_head_file(path)
