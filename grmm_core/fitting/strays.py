"""Strands that go their own way: a bend that is right for the hair around leaves some as hooks and brackets above it.

They are told by their neighbours: hardly any has a course like theirs. On both sides of a parting many have, and among coils
nobody's is like another's, so neither counts as astray.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..hair.grids import nearest
from ..hair.groom import Groom
from ..hair.strands import evened, lengths_of

if TYPE_CHECKING:
    from ..head import HeadModel

AROUND, FEW = 16, 4  # roots beside one, and of how many of them the courses must be like its own
POINTS = 5  # of a course
ASTRAY, USUAL = 0.3, 2.5  # lengths that courses are apart, at least, and times as far as those of nine tenths of all
LED = 1.3  # times as far as before a bend
LONG = 0.6  # of the lengths around: shorter strands lie hidden, or are those of a hairline


def without_strays(groom: Groom, before: Groom, head: HeadModel) -> Groom:
    """A groom of scalp hair without the few strands that have another course than all around them, and had not before.

    Args:
        groom: Bent.
        before: The same strands before.
        head: Whose mesh they stand on.
    """
    if len(groom) <= AROUND:
        return groom
    (strands, lengths), (earlier, whole) = (_standing(one, head) for one in (groom, before))
    beside = nearest(strands[:, 0], strands[:, 0], AROUND + 1)[0][:, 1:]
    alone, was = _alone(strands, lengths, beside), _alone(earlier, whole, beside)
    astray = (alone > max(ASTRAY, USUAL * float(np.quantile(alone, 0.9)))) & (alone > LED * was)
    return groom.select(~(astray & (lengths > LONG * np.median(lengths[beside], 1))))


def _standing(groom: Groom, head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Strands on the mean head, [N, K, 3] metres, and their lengths, [N]."""
    vertices, count = np.asarray(head.v_template, np.float64), int(groom.counts.max())
    even = groom.resampled(count)
    strands = even.posed(even.frames(vertices, head.faces), vertices).reshape(len(even), count, 3)
    return strands, lengths_of(strands)


def _alone(strands: np.ndarray, lengths: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """How far strands' courses are from the few most like them among those `beside` [N, AROUND], in lengths, [N]."""
    courses = evened(strands - strands[:, :1], POINTS)[:, 1:]
    apart = np.linalg.norm(courses[:, None] - courses[beside], axis=3).max(2) / np.maximum(lengths, 1e-4)[:, None]
    found: np.ndarray = np.sort(apart, 1)[:, FEW - 1]
    return found
