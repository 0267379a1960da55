"""Grooms made ready for the mean of a head, by their contents: a fit asks for the same ones several times. Numpy only."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING

import numpy as np

from ..compute.recent import Recent
from .body import outside
from .groom import Groom
from .strands import StrandBlock, blocks_of

if TYPE_CHECKING:
    from ..head import HeadModel

_READY: Recent[tuple[StrandBlock, ...]] = Recent(3)


def ready(groom: Groom, head: HeadModel) -> tuple[StrandBlock, ...]:
    """Make a groom ready, scalp hair in the light that it gets outside of the head's skin. Raises as `strands.blocks_of`."""
    mean = np.asarray(head.v_template, np.float64)
    lies, plain = functools.partial(outside, head, mean), dataclasses.replace(groom, tints=None)
    made = _READY.get((head, *strands_of(groom)), lambda: blocks_of(plain, mean, head.faces, lies))
    if groom.tints is None or not groom.tints.any():
        return made
    own = ((block, groom.tints[block.rows]) for block in made)
    return tuple(dataclasses.replace(block, tints=tints if tints.any() else None) for block, tints in own)


def strands_of(groom: Groom) -> tuple[np.ndarray, ...]:
    """All that a groom is but its colors, which a fit finds last."""
    return tuple(getattr(groom, field.name) for field in dataclasses.fields(groom) if field.name != "tints")
