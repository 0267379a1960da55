"""From the names that programs give their shapes to ARKit's 52.

Most programs use ARKit's names in some spelling. Audio2Face's older rig has 46 shapes of its own, named after the facial action
coding system; each is turned into the ARKit shapes that mean the same movement. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...controls.names import ARKIT_NAMES

_LOOKUP = {name.lower(): i for i, name in enumerate(ARKIT_NAMES)}
_MIN_FACS = 10  # names of that rig that a file must have: single ones might be anybody's

# With L and R for the sides.
_FACS_PAIRS = {
    "browLower": "browDown", "outerBrowRaiser": "browOuterUp", "eyesClose": "eyeBlink", "eyesUpperLidRaiser": "eyeWide",
    "squint": "eyeSquint", "cheekRaiser": "cheekSquint", "noseWrinkler": "noseSneer", "dimpler": "mouthDimple",
    "dimple": "mouthDimple", "lipCornerPuller": "mouthSmile", "lipCornerDepressor": "mouthFrown",
    "lipStretcher": "mouthStretch", "upperLipRaiser": "mouthUpperUp", "lowerLipDepressor": "mouthLowerDown",
}  # fmt: skip
# jawDropLipTowards is a jaw that drops behind closed lips: mouthClose undoes what opens them.
_FACS: dict[str, dict[str, float]] = {
    "innerBrowRaiserL": {"browInnerUp": 0.5}, "innerBrowRaiserR": {"browInnerUp": 0.5},
    "cheekPuffL": {"cheekPuff": 0.5}, "cheekPuffR": {"cheekPuff": 0.5},
    "eyesLookLeft": {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
    "eyesLookRight": {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
    "eyesLookUp": {"eyeLookUpLeft": 1.0, "eyeLookUpRight": 1.0},
    "eyesLookDown": {"eyeLookDownLeft": 1.0, "eyeLookDownRight": 1.0},
    "jawDrop": {"jawOpen": 1.0}, "jawDropLipTowards": {"jawOpen": 0.6, "mouthClose": 0.6},
    "jawThrust": {"jawForward": 1.0}, "jawSlideLeft": {"jawLeft": 1.0}, "jawSlideRight": {"jawRight": 1.0},
    "mouthSlideLeft": {"mouthLeft": 1.0}, "mouthSlideRight": {"mouthRight": 1.0},
    "chinRaiser": {"mouthShrugLower": 1.0}, "lipPressor": {"mouthPressLeft": 1.0, "mouthPressRight": 1.0},
    "pucker": {"mouthPucker": 1.0}, "funneler": {"mouthFunnel": 1.0},
    "lipSuck": {"mouthRollLower": 1.0, "mouthRollUpper": 1.0},
}  # fmt: skip
_FACS |= {f"{name}{side[0]}": {f"{own}{side}": 1.0} for name, own in _FACS_PAIRS.items() for side in ("Left", "Right")}
_FACS_LOOKUP = {name.lower(): parts for name, parts in _FACS.items()}


@dataclass(frozen=True)
class ShapeMap:
    """How columns of a file become ARKit weights.

    Attributes:
        matrix: [columns, 52]; weights = values @ matrix.
        used: Columns that count, [K].
        arkit_indices: Of the ARKit shapes that they give.
        warnings: A sentence where the file has another rig's names.
    """

    matrix: np.ndarray
    used: np.ndarray
    arkit_indices: frozenset[int]
    warnings: tuple[str, ...] = ()

    def weights(self, values: np.ndarray) -> np.ndarray:
        """ARKit weights [T, 52] float32 of values [T, columns]; NaN where a column that counts is NaN."""
        return (np.asarray(values, np.float64)[:, self.used] @ self.matrix[self.used]).astype(np.float32)


def arkit_index(name: str) -> int | None:
    """Index of an ARKit name however its program spells it (EyeBlinkLeft, eyeBlink_L, blendShapes.eyeBlinkLeft), or None."""
    return _LOOKUP.get(_key(name))


def _key(name: str) -> str:
    key = name.strip().rsplit(".", 1)[-1].lower()
    if key.endswith("_l"):
        key = key[:-2] + "left"
    elif key.endswith("_r"):
        key = key[:-2] + "right"
    return key.replace("_", "").replace(" ", "")


def map_shapes(names: Sequence[str]) -> ShapeMap:
    """Return what columns of these names give; `found` is empty where none of them is known."""
    matrix = np.zeros((len(names), len(ARKIT_NAMES)))
    own = {i: k for k, name in enumerate(names) if (i := arkit_index(name)) is not None}
    warnings: tuple[str, ...] = ()
    if own:
        for i, k in own.items():
            matrix[k, i] = 1.0
    else:
        facs = {k: _FACS_LOOKUP[key] for k, name in enumerate(names) if (key := name.strip().lower()) in _FACS_LOOKUP}
        if len(facs) >= _MIN_FACS:
            for k, parts in facs.items():
                for name, factor in parts.items():
                    matrix[k, _LOOKUP[name.lower()]] = factor
            warnings = (f"Audio2Face's {len(facs)} own shapes were turned into the ARKit shapes that mean the same.",)
    used = np.flatnonzero(matrix.any(1))
    return ShapeMap(matrix, used, frozenset(np.flatnonzero(matrix.any(0)).tolist()), warnings)
