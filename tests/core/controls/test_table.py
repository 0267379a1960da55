"""The table of controls: complete, consistent, and what reads it in the core."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from grmm_core.cli import main
from grmm_core.controls import table
from grmm_core.controls.control import in_words, mirrored, side_of
from grmm_core.controls.frame import Controls, arkit_weights
from grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES, EXPRESSION_NAMES, JOINT_NAMES
from grmm_core.controls.table import ARRAYS, CONTROLS, EXPRESSIONS, JOINTS, REGIONS, SECTIONS, SLIDERS
from grmm_core.errors import ControlError, ShapeError

SETTABLE = [name.replace(".N", ".2") for name, _ in table.settable()]


def test_every_value_of_a_frame_has_a_row():
    held = {control.field for control in CONTROLS.values()}
    assert held == {field.name for field in fields(Controls)}
    assert [control.name for control in EXPRESSIONS] == list(EXPRESSION_NAMES)
    assert [control.index for control in EXPRESSIONS] == list(range(len(EXPRESSION_NAMES)))
    assert sorted(control.index for control in JOINTS) == list(range(len(JOINT_NAMES)))
    assert len(CONTROLS) == len(EXPRESSIONS) + len(ARRAYS) + len(SLIDERS) + len(JOINTS)


@pytest.mark.parametrize("control", CONTROLS.values(), ids=lambda control: control.name)
def test_rows_are_whole(control):
    limits = control.limits
    assert limits.low <= limits.soft_low < limits.soft_high <= limits.high
    assert limits.low <= control.rest <= limits.high
    assert control.label
    assert control.description
    assert not control.description.endswith(".")
    assert control.section in [section.key for section in SECTIONS]
    assert CONTROLS[control.partner].partner == control.name
    assert CONTROLS[control.partner].limits == limits


def test_regions_hold_each_expression_once():
    assert sorted(name for names in REGIONS.values() for name in names) == sorted(EXPRESSION_NAMES)


def test_sides():
    assert [side_of(n) for n in ("eyeBlinkLeft", "right_eye", "unitEyeLeftSlit", "jawOpen")] == ["left", "right", "left", ""]
    assert [side_of(n) for n in ("jawLeft", "mouthRight")] == ["", ""]  # movements to a side
    assert [mirrored(n) for n in ("jawLeft", "left_eye", "tongueOut")] == ["jawRight", "right_eye", "tongueOut"]
    assert in_words("mouthSmileLeft") == "Mouth Smile Left"


@pytest.mark.parametrize("name", SETTABLE)
def test_each_name_sets_its_value_and_nothing_else(name):
    control, _ = table.locate(name)
    value = np.float32(control.limits.soft_low + 0.87 * (control.limits.soft_high - control.limits.soft_low))
    found = Controls().set_named({name: float(value)})
    changed = [f.name for f in fields(Controls) if not np.array_equal(getattr(found, f.name), getattr(Controls(), f.name))]
    assert changed == [control.field]
    assert np.max(getattr(found, control.field)) == value
    assert np.count_nonzero(getattr(found, control.field)) == (2 if name.startswith("eyes.") else 1)
    assert found.key() != Controls().key()
    assert found.validate().key() == found.key()
    for beyond in (control.limits.low - 0.1, control.limits.high + 0.1):
        with pytest.raises(ControlError, match="set it between"):
            Controls().set_named({name: beyond})


def test_keys_tell_frames_apart():
    assert Controls().key() == Controls().validate().key()
    one, other = Controls(shape=np.ones(1)), Controls(expression=np.ones(1))
    assert len({one.key(), other.key(), Controls().key(), replace(one, residual_strength=0.5).key()}) == 4


def test_at_rest_the_person_stays():
    values = {name: 0.25 for name in SETTABLE}
    found = Controls().set_named(values).at_rest()
    for field in fields(Controls):
        kept = field.name not in ("aligned", "expression", "pose", "z_exp")
        assert np.array_equal(getattr(found, field.name), getattr(Controls(), field.name)) is not kept, field.name


def test_weights_of_the_aligned_expressions_alone_are_enough():
    short = Controls(aligned=np.ones(len(ALIGNED_NAMES)))
    assert short.validate().aligned.shape == (len(EXPRESSION_NAMES),)
    assert arkit_weights(short).shape == (len(ARKIT_NAMES),)
    with pytest.raises(ShapeError, match="aligned"):
        Controls(aligned=np.ones(len(ALIGNED_NAMES) - 1)).validate()
    with pytest.raises(ShapeError, match="at most 300"):
        Controls(shape=np.ones(301)).validate()


def test_the_command_line_lists_the_table(capsys):
    assert main(["render", "--list-controls"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    for name, control in table.settable():
        assert control.description in lines[name]
        assert f"{control.limits.low:.4g} to {control.limits.high:.4g}" in lines[name]
