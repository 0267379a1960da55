"""The table of controls: everything that an animator can set, said once.

The command line, validation, the rig's properties and drivers, panels, reset, mirror, presets, poses, performances, and what
tells whether a frame changed all read it. A new slider is a field of `Controls` with its row, and whatever uses its value; an
expression is a recipe in `names`. How to add either is in `docs/extending.md`. Needs numpy only.

Names that `set_named` and `--set` take:

=====================  ==================================================================================
``jawOpen`` ...        an expression: one of the 52 ARKit shapes, 8 mixtures, or a compound (`EXPRESSIONS`), 0..1
``expression.N``       component N of an array (`ARRAYS`)
``neck.x`` ``jaw.y``   rotation in radians about a head axis; also ``left_eye.x``, ``right_eye.y``
``eyes.pitch``         both eyes, radians: pitch about x (positive looks down), yaw about y (positive to the subject's left)
``residual_strength``  any other slider by its name (`SLIDERS`)
=====================  ==================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..errors import ControlError, ShapeError
from .control import Control, Limits, Section, Unit, in_words, is_sideways, without_side
from .names import ALIGNED_NAMES, COMPOUNDS, EXPRESSION_NAMES, JOINT_NAMES, MIXTURES, WORDS

SECTIONS: tuple[Section, ...] = (
    Section("EXPRESSION", "Expression", "Named expressions and expression coefficients"),
    Section("POSE", "Head, Jaw and Eyes", "Neck, jaw, eyes and root"),
    Section("IDENTITY", "Identity", "Shape and residual identity"),
    Section("DETAIL", "Learned Detail", "Residual expression, its saved codes, and strength"),
)
SHAPE, EXPRESSION, Z_ID, Z_EXP, STRENGTH = "shape", "expression", "z_id", "z_exp", "residual_strength"
EXPRESSION_LIMITS = Limits(-1.0, 2.0, 0.0, 1.0)
_CODE_LIMITS = Limits(-20.0, 20.0, -3.0, 3.0)
_TURN = Limits(-math.pi, math.pi, -math.pi / 2, math.pi / 2)
_AXES = {"x": 0, "y": 1, "z": 2}
_REGION_PREFIXES: dict[str, tuple[str, ...]] = {
    "Brows": ("brow",),
    "Eyelids": ("eyeBlink", "eyeSquint", "eyeWide"),
    "Gaze": ("eyeLook",),
    "Cheeks": ("cheek",),
    "Nose": ("nose",),
    "Jaw": ("jaw",),
    "Lips": tuple(f"mouth{word}" for word in ("Close", "Funnel", "Lower", "Press", "Pucker", "Roll", "Shrug", "Upper")),
    "Mouth": ("mouth",),  # what is left: corners, and the whole mouth to a side
    "Tongue": ("tongue",),
}  # the first that fits
_RECIPES = "Mixtures"  # the region of expressions that are made of others
_ROTATION = "x pitch, positive looks down; y yaw, positive to the subject's left; z roll; expressions add to it"
_THREE, _TWO = ("Pitch", "Yaw", "Roll"), ("Pitch", "Yaw")
_SHOWN_ANGLES: dict[str, tuple[str, ...]] = {"root": (), "neck": _THREE, "jaw": _THREE, "left_eye": _TWO, "right_eye": _TWO}


def _empty() -> np.ndarray:
    return np.zeros(0, np.float32)


def _row(
    label: str,
    description: str,
    section: str,
    limits: Limits,
    unit: Unit,
    *,
    size: int = 0,
    in_poses: bool = False,
    name: str = "",
) -> dict[str, Control]:
    """Metadata of a field of `Controls`: its row (see `Control`). Its value at rest is the field's default."""
    return {"row": Control(name, label, description, section, limits, unit, size=size, in_poses=in_poses)}


@dataclass
class Controls:
    """One frame of an avatar. Arrays may be shorter than the model's; the rest is zero.

    Attributes:
        aligned: Weights of the named expressions in the order of `EXPRESSION_NAMES`, the 60 aligned ones first; they drive the
            head's expression and the residual code together. [60] at least.
        expression: Head-model expression coefficients added to those of `aligned`, [<=100].
        shape: Offset to the avatar's shape coefficients, [<=300].
        pose: XYZ Euler angles in radians of root, neck, jaw, left eye, right eye in head axes, [5, 3].
        z_id: Offset to the avatar's residual identity code, [<=512].
        z_exp: Offset to the residual expression code that `aligned` gives, [<=256].
        residual_strength: Factor of the learned mesh displacement and of `z_exp`'s effect, 0..1.
    """

    aligned: np.ndarray = field(default_factory=lambda: np.zeros(len(EXPRESSION_NAMES), np.float32))
    expression: np.ndarray = field(default_factory=_empty, metadata=_row(
        "Expression", "Expression coefficients of the head model, added to those of the named expressions", "EXPRESSION",
        Limits(-6.0, 6.0, -1.0, 1.0),  # with an aligned 2 on top still inside a shape key's -10..10
        "standard deviations", size=100, in_poses=True,
    ))  # fmt: skip
    shape: np.ndarray = field(default_factory=_empty, metadata=_row(
        "Shape", "Shape coefficients of the head model, added to the avatar's own, in standard deviations", "IDENTITY",
        Limits(-8.0, 8.0, -3.0, 3.0), "standard deviations", size=300,
    ))  # fmt: skip
    pose: np.ndarray = field(default_factory=lambda: np.zeros((len(JOINT_NAMES), 3), np.float32))
    z_id: np.ndarray = field(default_factory=_empty, metadata=_row(
        "Residual Identity", "Residual identity code, added to the avatar's own", "IDENTITY",
        _CODE_LIMITS, "standard deviations", size=512,
    ))  # fmt: skip
    z_exp: np.ndarray = field(default_factory=_empty, metadata=_row(
        "Residual Expression", "Residual expression code, added to what the named expressions give", "DETAIL",
        _CODE_LIMITS, "standard deviations", size=256, in_poses=True,
    ))  # fmt: skip
    residual_strength: float = field(default=1.0, metadata=_row(
        "Strength", "Strength of the learned detail: 0 is the head model alone, 1 the trained model", "DETAIL",
        Limits(0.0, 1.0, 0.0, 1.0), "share",
    ))  # fmt: skip

    def validate(self) -> Controls:
        """Return the controls as float32 arrays of known shapes; arrays that are so already are shared, not copied.

        Raises:
            ControlError: A value is NaN or infinite; the control is named.
            ShapeError: An array is of another shape than documented.
        """
        clean: dict[str, Any] = {f.name: np.asarray(getattr(self, f.name), np.float32) for f in fields(self)}
        for name, array in clean.items():
            if not np.isfinite(array).all():
                raise ControlError(
                    f"Control {_name_of(name, np.argwhere(~np.isfinite(array))[0])} is not a finite number; set it to a number."
                )
        aligned, count = clean["aligned"], len(EXPRESSION_NAMES)
        if aligned.shape not in ((len(ALIGNED_NAMES),), (count,)):
            raise ShapeError(f"Controls.aligned has shape {aligned.shape}; it must be ({count},).")
        if aligned.size < count:
            clean["aligned"] = np.pad(aligned, (0, count - aligned.size))
        if clean["pose"].shape != (len(JOINT_NAMES), 3):
            raise ShapeError(f"Controls.pose has shape {clean['pose'].shape}; it must be ({len(JOINT_NAMES)}, 3).")
        for control in ARRAYS:
            shape = clean[control.field].shape
            if len(shape) != 1 or shape[0] > control.size:
                raise ShapeError(
                    f"Controls.{control.field} has shape {shape}; it must be one row, at most {control.size} long."
                )
        sliders: dict[str, Any] = {slider.field: float(clean.pop(slider.field)) for slider in SLIDERS}
        return Controls(**clean, **sliders)

    def copy(self) -> Controls:
        """Return a copy whose arrays can be changed in place. Raises as `validate`."""
        return deepcopy(self.validate())

    def set_named(self, values: Mapping[str, float]) -> Controls:
        """Return a copy with the named controls set (see the module's table).

        Raises:
            ControlError: Unknown name, or a value that is no finite number or beyond the control's range.
        """
        result = self.copy()
        for name, value in values.items():
            value = float(value)
            control, places = locate(name)
            if not math.isfinite(value):
                raise ControlError(f"Control {name} is not a finite number; set it to a number.")
            low, high = control.limits.low, control.limits.high
            if not low <= value <= high:
                raise ControlError(f"Control {name} is {value:g}; set it between {low:.4g} and {high:.4g}.")
            if not places:
                setattr(result, control.field, value)
            for place in places:
                array = getattr(result, control.field)
                if control in ARRAYS and array.size <= place[0]:
                    array = np.pad(array, (0, place[0] + 1 - array.size))
                    setattr(result, control.field, array)
                array[place] = value
        return result

    def at_rest(self) -> Controls:
        """Return the same person, drawn the same way, whose face does nothing: no expression and no pose."""
        moving = {control.field for control in CONTROLS.values() if control.in_poses or control.source == "bone"}
        return Controls(**{f.name: getattr(self, f.name) for f in fields(self) if f.name not in moving})

    def key(self) -> bytes:
        """Return what tells frames apart: the same bytes exactly where every control is the same."""
        arrays = [np.asarray(getattr(self, f.name), np.float32) for f in fields(self)]
        return b"".join(b"%d:%b" % (array.size, array.tobytes()) for array in arrays)


def _expression(index: int, name: str) -> Control:
    recipe = MIXTURES.get(name) or COMPOUNDS.get(name)
    stem = without_side(name)
    both = WORDS.get(stem) or in_words(stem)
    label = f"{both} {in_words(name.removeprefix(stem))}" if name != stem else both
    if recipe is None:
        region = next(region for region, prefixes in _REGION_PREFIXES.items() if name.startswith(prefixes))
        what = f"ARKit shape {name}, moves the head and its learned detail; 0 is rest, 1 the full expression"
    else:
        region = _RECIPES
        parts = ", ".join(f"{part} {weight:g}" for part, weight in recipe.items())
        what = f"{'mixture with a learned detail of its own' if name in MIXTURES else 'the sum of its parts'} ({parts})"
    return Control(
        name, label, f"{label}: {what}", "EXPRESSION", EXPRESSION_LIMITS, "weight", region=region, field="aligned",
        index=index, in_poses=True, both=f"{both} to Side" if is_sideways(name) else both,
    )  # fmt: skip


def _joint(name: str) -> Control:
    label = name.replace("_", " ").title()
    return Control(
        name, label, f"{label}: {_ROTATION}", "POSE", _TURN, "radians", region=name, size=3, field="pose",
        index=JOINT_NAMES.index(name), source="bone", axes=_SHOWN_ANGLES[name],
    )  # fmt: skip


def _field_rows() -> Iterator[Control]:
    for f in fields(Controls):
        if f.metadata:
            row: Control = f.metadata["row"]
            rest = row.rest if row.size else getattr(Controls, f.name)
            yield replace(row, name=row.name or f.name, field=f.name, rest=rest)


EXPRESSIONS: tuple[Control, ...] = tuple(_expression(index, name) for index, name in enumerate(EXPRESSION_NAMES))
"""The named expressions in the order of `Controls.aligned`."""
ARRAYS: tuple[Control, ...] = tuple(row for row in _field_rows() if row.size)
SLIDERS: tuple[Control, ...] = tuple(row for row in _field_rows() if not row.size)
"""Single numbers that are no expressions."""
JOINTS: tuple[Control, ...] = tuple(_joint(name) for name in (*JOINT_NAMES[1:], JOINT_NAMES[0]))
"""The joints in the order in which they are shown; the root, which places the head in a scene, comes last and is not shown."""
CONTROLS: dict[str, Control] = {control.name: control for control in (*EXPRESSIONS, *ARRAYS, *SLIDERS, *JOINTS)}
"""All controls by name."""
REGIONS: dict[str, tuple[str, ...]] = {
    region: tuple(control.name for control in EXPRESSIONS if control.region == region)
    for region in (*_REGION_PREFIXES, _RECIPES)
}
"""Region of the face to the expressions in it; each is in exactly one."""


def locate(name: str) -> tuple[Control, list[tuple[int, ...]]]:
    """Return the control that a name of `--set` means, and the places in its array that it sets; none for a slider.

    Raises:
        ControlError: There is none of that name.
    """
    group, _, member = name.partition(".")
    if group == "eyes" and member in ("pitch", "yaw"):
        axis = ("pitch", "yaw").index(member)
        return CONTROLS["left_eye"], [(JOINT_NAMES.index(eye), axis) for eye in ("left_eye", "right_eye")]
    whole, array = CONTROLS.get(name), CONTROLS.get(group)
    if whole is not None and not whole.size:
        return whole, [] if whole.index is None else [(whole.index,)]
    if array is not None and array.index is not None and array.axes and member in _AXES:
        return array, [(array.index, _AXES[member])]
    if array is not None and array.index is None and member.isascii() and member.isdigit() and int(member) < array.size:
        return array, [(int(member),)]
    raise ControlError(
        f"There is no control named {name!r}; use an ARKit name such as jawOpen, or expression.N, shape.N, jaw.x, eyes.yaw."
    )


def _name_of(attribute: str, place: np.ndarray) -> str:
    """Name, for messages, of the value at a place of an attribute of `Controls`."""
    index = tuple(int(i) for i in place)
    if attribute == "aligned" and len(index) == 1 and index[0] < len(EXPRESSION_NAMES):
        return EXPRESSION_NAMES[index[0]]
    if attribute == "pose" and len(index) == 2 and index[0] < len(JOINT_NAMES):
        return f"{JOINT_NAMES[index[0]]}.{'xyz'[index[1]]}"
    names = {control.field: control.name for control in (*ARRAYS, *SLIDERS)}
    return ".".join([names.get(attribute, attribute), *map(str, index)])


def settable() -> Iterator[tuple[str, Control]]:
    """Yield each name that `--set` takes, with N for a place in an array, and the control that it means."""
    for control in CONTROLS.values():
        if control.axes:
            yield from ((f"{control.name}.{axis}", control) for axis in _AXES)
        elif control.source == "property":
            yield f"{control.name}.N" if control.size else control.name, control
    both = replace(CONTROLS["left_eye"], name="eyes", description=f"Both eyes: {_ROTATION}")
    yield from ((f"{both.name}.{axis}", both) for axis in ("pitch", "yaw"))
