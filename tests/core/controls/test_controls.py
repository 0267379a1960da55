"""Controls: names, mixtures, resolving, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.frame import ALIGNED_TO_ARKIT, Controls, parse_assignments, resolve, weights_of
from grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES, EXPRESSION_NAMES, MIXTURES
from grmm_core.errors import ControlError


class Basis:
    arkit_to_expression = np.eye(52, 100, dtype=np.float32)
    expression_pose = np.zeros((100, 5, 3), np.float32)


Basis.expression_pose[ARKIT_NAMES.index("jawOpen"), 2, 0] = 0.4


def test_mixtures_are_their_recipes():
    for name, recipe in MIXTURES.items():
        mixture = resolve(Controls().set_named({name: 0.5}), Basis())
        parts = resolve(Controls().set_named({k: 0.5 * v for k, v in recipe.items()}), Basis())
        np.testing.assert_allclose(mixture.expression, parts.expression, atol=1e-6)
        np.testing.assert_allclose(mixture.pose, parts.pose, atol=1e-6)
        assert mixture.aligned[ALIGNED_NAMES.index(name)] == 0.5
    assert ALIGNED_TO_ARKIT.shape == (60, 52)


def test_pose_is_the_sum_of_control_and_expression():
    resolved = resolve(Controls().set_named({"jaw.x": 0.1, "jawOpen": 0.5, "expression.24": 0.25, "eyes.yaw": 0.2}), Basis())
    assert ARKIT_NAMES[24] == "jawOpen"
    assert resolved.pose[2, 0] == pytest.approx(0.1 + 0.4 * 0.75)
    assert resolved.pose[3:, 1] == pytest.approx([0.2, 0.2])


def test_the_gain_of_a_person_says_how_far_shapes_go():
    gain = np.random.default_rng(0).uniform(0.5, 1.5, 52).astype(np.float32)
    controls = Controls().set_named({"jawOpen": 0.5, "eyeBlinkLeft": 1.0, "surprise": 0.3, "expression.9": 0.2})
    plain, resolved = resolve(controls, Basis()), resolve(controls, Basis(), gain)
    given = np.zeros(100, np.float32)
    given[9] = 0.2
    by_name = (plain.expression - given) * np.append(gain, np.ones(48))
    np.testing.assert_allclose(resolved.expression, by_name + given, rtol=1e-6)
    np.testing.assert_allclose(resolved.aligned, plain.aligned * np.append(gain, np.ones(8)), rtol=1e-6)
    assert resolved.pose[2, 0] == pytest.approx(0.4 * resolved.expression[ARKIT_NAMES.index("jawOpen")])
    back = resolve(Controls(aligned=weights_of(plain.aligned, gain)), Basis(), gain)
    np.testing.assert_allclose(back.aligned, plain.aligned, rtol=1e-6)


def test_setting_controls_leaves_the_original_alone():
    controls = Controls()
    controls.set_named({"jawOpen": 1.0, "shape.3": 1.0})
    assert not controls.aligned.any()
    assert controls.shape.size == 0


@pytest.mark.parametrize("name", ["jawopen", "shape.300", "shape.-1", "nose.x", "eyes.roll", "", "z_id.512", "z_id.²"])
def test_unknown_controls_are_named(name):
    with pytest.raises(ControlError, match="no control named"):
        Controls().set_named({name: 0.0})


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_controls_that_are_not_numbers_are_named(value):
    with pytest.raises(ControlError, match="jawOpen"):
        Controls().set_named({"jawOpen": value})
    controls = Controls()
    controls.pose[2, 0] = value
    with pytest.raises(ControlError, match=r"jaw\.x"):
        resolve(controls, Basis())


def test_assignments_of_the_command_line():
    assert parse_assignments(["jawOpen=0.5", "jaw.x = -1e-1"]) == {"jawOpen": 0.5, "jaw.x": -0.1}
    for text in ("jawOpen", "jawOpen=wide"):
        with pytest.raises(ControlError, match="NAME=NUMBER"):
            parse_assignments([text])


def test_validating_copies_nothing_that_is_right_already():
    controls = Controls().set_named({"jawOpen": 0.5, "shape.3": 1.0})
    again = controls.validate()
    assert all(getattr(again, name) is getattr(controls, name) for name in ("aligned", "pose", "shape", "expression", "z_id"))
    other = controls.copy()
    other.aligned[:] = 1.0
    other.pose[:] = 1.0
    assert controls.aligned.sum() == 0.5
    assert not controls.pose.any()


def test_resolving_leaves_the_controls_alone():
    controls = Controls().set_named({name: 0.3 for name in EXPRESSION_NAMES})
    before = controls.key()
    resolve(controls, Basis())
    assert controls.key() == before
