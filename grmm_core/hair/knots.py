"""Hair that is tied: strands that end in a knot, out of which a tail or a bun grows. Numpy only.

A tail's strands all grow from one triangle of the head, as the studio and `tools.grooms` make them, and most others come from
farther away to end beside it. What ends there is held: it gets neither longer nor shorter by a setting.
"""

from __future__ import annotations

import numpy as np

from .groom import Groom
from .roots import SCALP

FROM_ONE, COME = 0.08, 0.4  # shares of the scalp's strands that grow from one triangle and that come to it, where it is a knot
HELD = 0.06  # metres around the middle of its roots within which strands end that are tied: a bun is as large


def tied(groom: Groom, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which strands of a groom on a head's vertices [V, 3] a knot holds at both ends, bool [N]."""
    held = np.zeros(len(groom), bool)
    scalp = np.flatnonzero(groom.groups == SCALP)
    if not len(scalp):
        return held
    triangles = groom.triangles[scalp]
    grown = triangles == np.bincount(triangles).argmax()
    if grown.mean() < FROM_ONE:
        return held
    frames = groom.frames(vertices, faces)
    roots, ends = frames.at(vertices)[0][scalp], groom.posed(frames, vertices)[groom.offsets[1:][scalp] - 1]
    from_afar, near = (np.linalg.norm(places - roots[grown].mean(0), axis=1) for places in (roots, ends))
    if ((from_afar > HELD) & (near < HELD)).mean() > COME:
        held[scalp] = near < HELD
    return held
