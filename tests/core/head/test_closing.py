"""Eyes and lips of people of all sizes: a blink shuts them, `mouthClose` closes what `jawOpen` opens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from eyeballs import both, eye_visibility, random_people

from grmm_core.controls.frame import Controls, resolve
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.head import arkit_gain, load_open_head
from grmm_core.head.closing import CLOSING


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def lids_apart(head, vertices):
    """Lower to upper lid at two places of each eye, metres; less than 0 where they have passed each other, [4]."""
    points = head.landmark_positions(vertices)
    return points[[37, 38, 43, 44], 1] - points[[41, 40, 47, 46], 1]


def test_a_blink_shuts_eyes_of_any_size_and_half_a_blink_half(head):
    gains = []
    for shape in (np.zeros(300), *random_people()):
        gain = arkit_gain(head, shape)
        assert (np.delete(gain, [ARKIT_NAMES.index(name) for name in CLOSING]) == 1.0).all()

        def blinking(weight, shape=shape, gain=gain):
            found = resolve(Controls().set_named(both("eyeBlink", weight)), head, gain)
            return head.vertices(shape, found.expression, found.pose)

        apart = [lids_apart(head, blinking(weight)) for weight in (0.0, 0.5, 1.0)]
        assert -0.001 < apart[2].max() < 0.0, "the last place to close is shut by a little"
        assert apart[2].min() > -0.004, "sculpted blinks go on for up to 6 mm"
        assert (0.2 * apart[0] < apart[1]).all()
        assert (apart[1] < 0.6 * apart[0]).all()
        for side in ("left", "right"):
            assert eye_visibility(head, blinking(1.0), side) <= 0.1 * eye_visibility(head, blinking(0.0), side)
        gains.append(gain[ARKIT_NAMES.index("eyeBlinkLeft")])
    assert max(gains) - min(gains) > 0.1


def test_lips_close_by_as_much_as_the_jaw_opens(head):
    for shape in (np.zeros(300), *random_people()):
        gain = arkit_gain(head, shape)

        def apart(shape=shape, gain=gain, **weights):
            found = resolve(Controls().set_named(weights), head, gain)
            points = head.landmark_positions(head.vertices(shape, found.expression, found.pose))
            return (points[[61, 62, 63], 1] - points[[67, 66, 65], 1]).mean()

        resting = apart()
        touching = min(max(resting, 0.0), 5e-4)
        for weight in (0.15, 0.3):
            left = apart(jawOpen=weight, mouthClose=weight) - touching
            assert -0.0012 < left < max(0.0012, resting), "lips that rest apart come together as the jaw opens"
        assert abs(apart(jawOpen=0.5, mouthClose=0.5) - touching) < 3e-4
        assert apart(jawOpen=0.5) - resting > 0.008


def test_a_head_without_landmarks_closes_as_it_was_sculpted(head):
    assert (arkit_gain(replace(head, landmarks68=None), np.zeros(300)) == 1.0).all()
