"""Write an avatar with the pictures of itself that its file carries, as a session draws it: hair, brows and all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from ..avatar import EXTENSION, Avatar, save_avatar
from . import create_session


def save_presented(
    avatar: Avatar,
    path: str | os.PathLike[str],
    weights: str | os.PathLike[str] | None,
    head: str | os.PathLike[str] | None = None,
) -> None:
    """Write an avatar with a thumbnail and a painting; the file appears whole or not at all.

    Args:
        avatar: Whose pictures are made anew.
        path: The `.grmm` file.
        weights: Name or file of the weights that the avatar was made with; None for the embedded ones.
        head: File of a head model other than the open one.

    Raises:
        FileAccessError: The file cannot be written.
        GrmmError: The avatar cannot be drawn.
    """
    with (
        tempfile.TemporaryDirectory(prefix="grmm-") as folder,
        create_session("local", weights=weights, head=head) as session,
    ):
        plain = Path(folder) / f"plain{EXTENSION}"
        save_avatar(avatar.with_pictures(b"", np.zeros((0, 0, 3), np.uint8)), plain)
        session.save(session.open(plain).id, path)
