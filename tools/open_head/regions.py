"""Named vertex sets of the open head, from the source's masks, parts and targets, and a few planes on the mean person."""

from __future__ import annotations

import numpy as np

from .landmarks import brow_height
from .source import Source
from .topology import Topology


def build_regions(source: Source, topology: Topology, template: np.ndarray) -> dict[str, np.ndarray]:
    """Return region name to sorted vertex indices.

    Skin regions: face, scalp, neck, ears, mouth_interior cover the skin without overlap; lips, left_lids, right_lids and
    brows are parts of the face.
    """
    mask = {name: topology.matrix @ source.mask(name) for name in ("ears", "eyelids", "inside-mouth", "lips")}
    partner = source.mirror()
    for name in ("lips", "eyelids"):  # painted by hand: a few vertices are in on one side only
        mask[name] = topology.matrix @ np.maximum(source.mask(name), source.mask(name)[partner])
    x, y, z = template.T
    skin = np.zeros(len(template), bool)
    skin[topology.parts["skin"]] = True
    mouth = skin & (mask["inside-mouth"] > 0.5)
    ears = skin & (mask["ears"] > 0.5) & ~mouth
    free = skin & ~mouth & ~ears
    # jaw line from below the ear to the chin; nape below the hairline
    neck = free & (y < -0.045 - 0.6 * np.maximum(z - 0.02, 0.0)) & ((z > -0.02) | (y < -0.055))
    neck |= free & (z < 0.0) & (y < np.maximum(0.03 + 2.0 * (z + 0.01), -0.055))  # behind the ears, below the hair
    hairline = np.where(z > -0.01, 0.03 + 0.8 * z, np.maximum(0.03 + 2.0 * (z + 0.01), -0.055))
    scalp = free & ~neck & (y > hairline)
    face = free & ~neck & ~scalp
    brows = face & (np.abs(y - brow_height(x)) < 0.0055) & (np.abs(x) > 0.008) & (np.abs(x) < 0.054) & (z > 0.04)
    lids = face & (mask["eyelids"] > 0.3)
    marks = {
        "face": face, "scalp": scalp, "neck": neck, "ears": ears, "mouth_interior": mouth,
        "lips": skin & (mask["lips"] > 0.5) & ~mouth, "brows": brows,
        "left_lids": lids & (x > 0), "right_lids": lids & (x < 0), "lids": lids,
    }  # fmt: skip
    regions = {name: np.flatnonzero(mark) for name, mark in marks.items()}
    for part in ("left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes"):
        regions[part] = topology.parts[part]
    return regions
