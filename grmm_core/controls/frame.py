"""From what an animator sets to what the model takes: expression coefficients, joint angles, weights of the learned codes.

`Controls` is the interchange type between the command line, Blender, performances and sessions; `resolve` turns it into the
quantities of the model. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import ControlError, ShapeError
from .names import ALIGNED_NAMES, ARKIT_NAMES, COMPOUNDS, EXPRESSION_NAMES, MIXTURES
from .table import Controls

__all__ = [
    "ALIGNED_TO_ARKIT", "EXPRESSIONS_TO_ARKIT", "Controls", "ExpressionBasis", "ResolvedControls", "arkit_weights",
    "parse_assignments", "resolve", "weights_of",
]  # fmt: skip


def _recipes(names: tuple[str, ...], recipes: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    """ARKit weights that each expression stands for: a recipe, or the shape of that name, [K, 52]."""
    rows = np.zeros((len(names), len(ARKIT_NAMES)), np.float32)
    for row, name in zip(rows, names, strict=True):
        for part, weight in recipes.get(name, {name: 1.0}).items():
            row[ARKIT_NAMES.index(part)] = weight
    rows.flags.writeable = False
    return rows


EXPRESSIONS_TO_ARKIT: np.ndarray = _recipes(EXPRESSION_NAMES, {**MIXTURES, **COMPOUNDS})
"""ARKit weights that each named expression stands for, [K, 52]."""
ALIGNED_TO_ARKIT: np.ndarray = EXPRESSIONS_TO_ARKIT[: len(ALIGNED_NAMES)]
"""Its first rows, those of the aligned expressions, [60, 52]."""


_SCULPTED = np.ones(len(ARKIT_NAMES), np.float32)


class ExpressionBasis(Protocol):
    """The part of `head.HeadModel` that `resolve` needs; `arkit_pose` [52, 5, 3] is read where there is one."""

    @property
    def arkit_to_expression(self) -> np.ndarray:
        """[52, E]."""
        ...

    @property
    def expression_pose(self) -> np.ndarray:
        """[E, 5, 3] radians."""
        ...


@dataclass(frozen=True)
class ResolvedControls:
    """Model inputs of one frame, before the avatar's own shape and codes are added.

    Attributes:
        expression: Head-model expression coefficients alpha_exp, [E].
        pose: XYZ Euler angles in radians of the five joints, [5, 3].
        aligned: Weights of the aligned expressions' codes, [60]; a compound counts as its parts.
    """

    expression: np.ndarray
    pose: np.ndarray
    aligned: np.ndarray


def arkit_weights(controls: Controls) -> np.ndarray:
    """Return the ARKit weights that the named expressions come to, [52]."""
    return np.asarray(controls.aligned @ EXPRESSIONS_TO_ARKIT[: len(controls.aligned)])


def resolve(controls: Controls, head: ExpressionBasis, gain: np.ndarray | None = None) -> ResolvedControls:
    """Combine sliders, coefficients and pose: linear in every control, so that Blender's drivers give the same numbers.

    expression = controls.expression + weights @ recipes @ arkit_to_expression;
    pose = controls.pose + sum_k expression_k expression_pose_k + weights @ recipes @ arkit_pose,
    where weights @ recipes are taken times the gain.

    Args:
        controls: Of one frame.
        head: What they move.
        gain: How far each ARKit shape goes on the person, [52]: `head.arkit_gain`. None: as far as it is sculpted, as those go
            that captures and fits know.

    Raises:
        ControlError, ShapeError: As `Controls.validate`.
    """
    clean, gain = controls.validate(), _SCULPTED if gain is None else gain
    arkit = arkit_weights(clean) * gain
    expression = arkit @ np.asarray(head.arkit_to_expression, np.float32)  # [E]
    count = expression.shape[0]
    if clean.expression.size > count:
        raise ShapeError(f"Controls.expression has {clean.expression.size} values; this head model takes {count}.")
    expression[: clean.expression.size] += clean.expression
    pose = clean.pose + np.einsum("e,ejk->jk", expression, np.asarray(head.expression_pose, np.float32))
    arkit_pose = getattr(head, "arkit_pose", None)  # FLAME: shapes turn joints of their own accord
    if arkit_pose is not None:
        pose = pose + np.einsum("a,ajk->jk", arkit, np.asarray(arkit_pose, np.float32))
    aligned, compounds = np.split(clean.aligned, [len(ALIGNED_NAMES)])
    aligned = aligned.copy()
    aligned[: len(ARKIT_NAMES)] += compounds @ EXPRESSIONS_TO_ARKIT[len(ALIGNED_NAMES) :]
    aligned[: len(ARKIT_NAMES)] *= gain
    return ResolvedControls(expression, pose.astype(np.float32), aligned)


def weights_of(aligned: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Weights of a person's sliders that resolve to sculpted ones, as captures and fits have them; both [60] or longer."""
    weights = np.array(aligned, np.float32)
    weights[: len(ARKIT_NAMES)] /= gain
    return weights


def parse_assignments(assignments: list[str]) -> dict[str, float]:
    """Parse `NAME=VALUE` texts of the command line. Raises `ControlError`."""
    values: dict[str, float] = {}
    for text in assignments:
        name, separator, value = text.partition("=")
        try:
            if not separator:
                raise ValueError
            values[name.strip()] = float(value)
        except ValueError as error:
            raise ControlError(f"{text!r} is not of the form NAME=NUMBER; write for example jawOpen=0.5.") from error
    return values
