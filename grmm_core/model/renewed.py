"""An avatar's own changes of the weights, where the weights under them were trained anew. Needs numpy only.

Changes are relative to the weights that an avatar was made on. Where later ones draw a region anew, such as teeth, the changes
of single Gaussians there fit nothing any more. What they have in common does, such as the tone of a photo: that is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from .layout import TexelLayout
from .weights_file import WeightsInfo

if TYPE_CHECKING:
    from ..head import HeadModel


def carried_over(
    deltas: Mapping[str, np.ndarray], sha256: str, info: WeightsInfo, layout: TexelLayout, head: HeadModel
) -> dict[str, np.ndarray]:
    """Changes as later weights take them: the median of the region in place of each change in a region trained anew.

    Args:
        deltas: `Avatar.deltas`.
        sha256: Of the weights that the avatar was made on.
        info: Of the weights that draw it.
        layout: Of their Gaussians.
        head: Of these weights.
    """
    found = dict(deltas)
    for region in info.renewed_since(sha256):
        inside = layout.within(head, region)
        if not inside.any():
            continue
        for name, array in deltas.items():
            if array.ndim == 2 and len(array) == len(layout):
                if found[name] is array:
                    found[name] = array.copy()
                found[name][inside] = np.median(array[inside], 0)
    return found
