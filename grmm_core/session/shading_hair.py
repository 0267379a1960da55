"""Hair as `lit` takes it: what throws shadows on skin and on itself. `compose` says which."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import NamedTuple

import numpy as np


class Hair(NamedTuple):
    """What throws shadows on the skin besides the mesh.

    Attributes:
        key: What identifies it.
        pieces: Gives its pieces (`Wardrobe.covering`).
        moves: They are where this frame's strands are; else on the head at rest, to be carried along by the head's turn.
    """

    key: Hashable
    pieces: Callable[[], tuple[np.ndarray, np.ndarray]]
    moves: bool
