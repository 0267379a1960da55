"""What an animator sets: one frame of a head, and how it becomes model inputs.

`Controls` is the interchange type between the command line, Blender, performances and sessions. It holds what can be
keyframed; `resolve` turns it into the quantities of the model. Needs numpy only.

Names that `set_named` and `grmm render --set` take:

=====================  ==================================================================================
``jawOpen`` ...        an aligned expression: one of the 52 ARKit shapes or 8 mixtures (`expressions`), 0..1
``expression.N``       component N of the head model's expression space, standard deviations for FLAME
``shape.N``            component N of the head model's shape space, standard deviations
``neck.x`` ``jaw.y``   rotation in radians about a head axis; also ``left_eye.x``, ``right_eye.y``
``eyes.pitch``         both eyes, radians: pitch about x (positive looks down), yaw about y (positive to the subject's left)
``z_id.N`` ``z_exp.N``  component N of the residual codes, added to the avatar's own
=====================  ==================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Protocol

import numpy as np

from ..errors import ControlError, ShapeError
from .names import ALIGNED_NAMES, ARKIT_NAMES, JOINT_NAMES, MIXTURE_NAMES, MIXTURES

_ALIGNED_INDEX = {name: i for i, name in enumerate(ALIGNED_NAMES)}
_JOINT_CONTROLS = JOINT_NAMES[1:]
_AXES = {"x": 0, "y": 1, "z": 2, "pitch": 0, "yaw": 1, "roll": 2}
_ARRAY_LIMITS = {"shape": 300, "expression": 100, "z_id": 512, "z_exp": 256}

ALIGNED_TO_ARKIT: np.ndarray = np.zeros((len(ALIGNED_NAMES), len(ARKIT_NAMES)), np.float32)  # [60, 52]
ALIGNED_TO_ARKIT[: len(ARKIT_NAMES)] = np.eye(len(ARKIT_NAMES), dtype=np.float32)
for _name in MIXTURE_NAMES:
    for _arkit, _weight in MIXTURES[_name].items():
        ALIGNED_TO_ARKIT[_ALIGNED_INDEX[_name], _ALIGNED_INDEX[_arkit]] = _weight
ALIGNED_TO_ARKIT.flags.writeable = False


class ExpressionBasis(Protocol):
    """The part of `head.HeadModel` that `resolve` needs; `arkit_pose` [52, 5, 3] is read where there is one."""

    arkit_to_expression: np.ndarray  # [52, E]
    expression_pose: np.ndarray  # [E, 5, 3] radians


def _zeros(count: int) -> np.ndarray:
    return np.zeros(count, np.float32)


@dataclass
class Controls:
    """One frame of an avatar. Arrays may be shorter than the model's; the rest is zero.

    Attributes:
        aligned: Weights of the 60 aligned expressions, [60]; they drive the head's expression and the residual code together.
        expression: Head-model expression coefficients added to those of `aligned`, [<=100].
        shape: Offset to the avatar's shape coefficients, [<=300].
        pose: XYZ Euler angles in radians of root, neck, jaw, left eye, right eye in head axes, [5, 3].
        z_id: Offset to the avatar's residual identity code, [<=512].
        z_exp: Offset to the residual expression code that `aligned` gives, [<=256].
        residual_strength: Factor of the learned mesh displacement and of `z_exp`'s effect, 0..1.
    """

    aligned: np.ndarray = field(default_factory=lambda: _zeros(len(ALIGNED_NAMES)))
    expression: np.ndarray = field(default_factory=lambda: _zeros(0))
    shape: np.ndarray = field(default_factory=lambda: _zeros(0))
    pose: np.ndarray = field(default_factory=lambda: np.zeros((len(JOINT_NAMES), 3), np.float32))
    z_id: np.ndarray = field(default_factory=lambda: _zeros(0))
    z_exp: np.ndarray = field(default_factory=lambda: _zeros(0))
    residual_strength: float = 1.0

    def validate(self) -> Controls:
        """Return a float32 copy of known shapes.

        Raises:
            ControlError: A value is NaN or infinite; the control is named.
            ShapeError: An array is of another shape than documented.
        """
        clean = {f.name: np.array(getattr(self, f.name), np.float32) for f in fields(self)}
        for name, array in clean.items():
            if not np.isfinite(array).all():
                where = np.argwhere(~np.isfinite(array))[0]
                raise ControlError(f"Control {_label(name, where)} is not a finite number; set it to a number.")
        if clean["aligned"].shape != (len(ALIGNED_NAMES),):
            raise ShapeError(f"Controls.aligned has shape {clean['aligned'].shape}; it must be ({len(ALIGNED_NAMES)},).")
        if clean["pose"].shape != (len(JOINT_NAMES), 3):
            raise ShapeError(f"Controls.pose has shape {clean['pose'].shape}; it must be ({len(JOINT_NAMES)}, 3).")
        for name, limit in _ARRAY_LIMITS.items():
            if clean[name].ndim != 1 or clean[name].size > limit:
                raise ShapeError(f"Controls.{name} has shape {clean[name].shape}; it must be one row, at most {limit} long.")
        strength = float(clean.pop("residual_strength"))
        return replace(self, **clean, residual_strength=strength)

    def set_named(self, values: Mapping[str, float]) -> Controls:
        """Return a copy with the named controls set (see the module's table).

        Raises:
            ControlError: Unknown name, or a value that is not a finite number.
        """
        result = self.validate()
        for name, value in values.items():
            value = float(value)
            if not math.isfinite(value):
                raise ControlError(f"Control {name} is not a finite number; set it to a number.")
            for attribute, index in _locate(name):
                array = getattr(result, attribute)
                if attribute in _ARRAY_LIMITS and array.size <= index[0]:
                    array = np.concatenate([array, _zeros(index[0] + 1 - array.size)])
                    setattr(result, attribute, array)
                array[index] = value
        return result


@dataclass(frozen=True)
class ResolvedControls:
    """Model inputs of one frame, before the avatar's own shape and codes are added.

    Attributes:
        expression: Head-model expression coefficients alpha_exp, [E].
        pose: XYZ Euler angles in radians of the five joints, [5, 3].
        aligned: Weights of the aligned expressions' codes, [60].
    """

    expression: np.ndarray
    pose: np.ndarray
    aligned: np.ndarray


def resolve(controls: Controls, head: ExpressionBasis) -> ResolvedControls:
    """Combine sliders, coefficients and pose: linear in every control, so that Blender's drivers give the same numbers.

    expression = controls.expression + aligned @ recipes @ arkit_to_expression;
    pose = controls.pose + sum_k expression_k expression_pose_k + aligned @ recipes @ arkit_pose.

    Raises:
        ControlError, ShapeError: As `Controls.validate`.
    """
    clean = controls.validate()
    arkit = clean.aligned @ ALIGNED_TO_ARKIT  # [52]
    expression = arkit @ np.asarray(head.arkit_to_expression, np.float32)  # [E]
    count = expression.shape[0]
    if clean.expression.size > count:
        raise ShapeError(f"Controls.expression has {clean.expression.size} values; this head model takes {count}.")
    expression[: clean.expression.size] += clean.expression
    pose = clean.pose + np.einsum("e,ejk->jk", expression, np.asarray(head.expression_pose, np.float32))
    arkit_pose = getattr(head, "arkit_pose", None)  # FLAME: shapes turn joints of their own accord
    if arkit_pose is not None:
        pose = pose + np.einsum("a,ajk->jk", arkit, np.asarray(arkit_pose, np.float32))
    return ResolvedControls(expression, pose.astype(np.float32), clean.aligned)


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


def _locate(name: str) -> list[tuple[str, tuple[int, ...]]]:
    """Return the array attributes and indices that a control name stands for."""
    if name in _ALIGNED_INDEX:
        return [("aligned", (_ALIGNED_INDEX[name],))]
    group, _, member = name.partition(".")
    if group in _ARRAY_LIMITS and member.isascii() and member.isdigit() and int(member) < _ARRAY_LIMITS[group]:
        return [(group, (int(member),))]
    if group in _JOINT_CONTROLS and member in ("x", "y", "z"):
        return [("pose", (JOINT_NAMES.index(group), _AXES[member]))]
    if group == "eyes" and member in ("pitch", "yaw"):
        return [("pose", (JOINT_NAMES.index(eye), _AXES[member])) for eye in ("left_eye", "right_eye")]
    raise ControlError(
        f"There is no control named {name!r}; use an ARKit name such as jawOpen, or expression.N, shape.N, jaw.x, eyes.yaw."
    )


def _label(name: str, where: np.ndarray) -> str:
    index = tuple(int(i) for i in where)
    if name == "aligned" and len(index) == 1 and index[0] < len(ALIGNED_NAMES):
        return ALIGNED_NAMES[index[0]]
    if name == "pose" and len(index) == 2:
        return f"{JOINT_NAMES[index[0]]}.{'xyz'[index[1]]}"
    return ".".join([name, *map(str, index)])
