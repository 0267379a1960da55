"""Write an avatar with the pictures of itself that its file carries, as a session draws it: hair, brows and all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from ..avatar import EXTENSION, Avatar, save_avatar
from .api import Session


def save_presented(avatar: Avatar, path: str | os.PathLike[str], session: Session) -> None:
    """Write an avatar with a thumbnail and a painting; the file appears whole or not at all.

    Args:
        avatar: Whose pictures are made anew.
        path: The `.grmm` file.
        session: With the weights and the head that the avatar was made with.

    Raises:
        FileAccessError: The file cannot be written.
        GrmmError: The avatar cannot be drawn.
    """
    with tempfile.TemporaryDirectory(prefix="grmm-") as folder:
        plain = Path(folder) / f"plain{EXTENSION}"
        save_avatar(avatar.with_pictures(b"", np.zeros((0, 0, 3), np.uint8)), plain)
        session.save(session.open(plain).id, path)
