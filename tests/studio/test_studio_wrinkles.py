"""Skin that follows the expression, and lashes of shut eyes."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.hair.lashes import Lashes
from grmm_core.hair.roots import LASHES
from grmm_core.head.open_head import load_people_model
from grmm_core.wrinkles.families import DRIVERS, line_depth
from grmm_core.wrinkles.lines import paint_lines
from grmm_core.wrinkles.noise import bump
from grmm_studio.grooming import make_groom
from grmm_studio.mesh import RenderMesh, region_vertices
from grmm_studio.subjects import draw_subject
from grmm_studio.wrinkles import LineField

OLD, YOUNG = 0, 20  # people of seed 5, aged 55 and 26


@pytest.fixture(scope="module")
def people():
    prior = load_people_model()
    return {index: draw_subject(5, index, prior) for index in (OLD, YOUNG)}


def coefficients(*names: str) -> np.ndarray:
    """Expression with all sides of the named shapes at 1, [52]."""
    return np.array([float(any(n in (name, name + "Left", name + "Right") for name in names)) for n in ARKIT_NAMES])


def field_of(head, subject) -> LineField:
    lips = np.zeros(len(head.v_template))
    lips[region_vertices(head, "lips")] = 1
    return LineField.build(subject, np.asarray(head.v_template, float), np.ones(len(lips)), lips)


def near(head, *centre: float) -> np.ndarray:
    return np.linalg.norm(np.asarray(head.v_template) - centre, axis=1) < 0.018


def test_every_driver_is_a_shape():
    shapes = set(ARKIT_NAMES) | {name.removesuffix("Left").removesuffix("Right") for name in ARKIT_NAMES}
    assert {name for drivers in DRIVERS.values() for name, _ in drivers} <= shapes


def test_the_neutral_skin_is_unchanged(head, people):
    lines, color = field_of(head, people[OLD]).amounts(np.zeros(52))
    assert not lines.any()
    np.testing.assert_array_equal(color, 1.0)


def test_raised_brows_change_the_forehead_only(head, people):
    lines, color = field_of(head, people[OLD]).amounts(coefficients("browInnerUp", "browOuterUp"))
    change = np.abs(lines).max(1) + np.abs(color - 1).max(1)
    assert change[near(head, 0.0, 0.085, 0.11)].max() > 0.5
    for elsewhere in ((0.0, -0.058, 0.11), (0.04, 0.0, 0.085), (0.0, -0.032, 0.11)):
        assert change[near(head, *elsewhere)].max() < 1e-3


def test_one_side_moves_alone(head, people):
    lines, _ = field_of(head, people[OLD]).amounts(np.eye(52)[ARKIT_NAMES.index("mouthSmileLeft")])
    assert lines[near(head, 0.035, -0.02, 0.09)].max() > 0.3
    assert lines[near(head, -0.035, -0.02, 0.09)].max() < 1e-3


def test_lines_deepen_with_age_and_nobody_has_none(people):
    assert line_depth(people[OLD].wrinkles) > 1.5 * line_depth(people[YOUNG].wrinkles) > 0.45


def test_blood_follows_the_expression(head, people):
    field = field_of(head, people[YOUNG])
    _, smile = field.amounts(coefficients("mouthSmile"))
    cheek = smile[near(head, 0.042, 0.004, 0.085)]
    assert (cheek[:, 1] / cheek[:, 0]).min() < 0.93  # redder
    _, pressed = field.amounts(coefficients("mouthRollLower", "mouthRollUpper"))
    lips = pressed[region_vertices(head, "lips")]
    assert (lips[:, 1] > lips[:, 0]).all()  # paler
    assert (lips[:, 1] > 1.05).all()


def test_painted_lines_are_personal_and_where_they_belong(people):
    x, y = np.meshgrid(np.linspace(-0.06, 0.06, 121), np.linspace(-0.07, 0.1, 171))
    front = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.10)], 1)
    lines = paint_lines(front, people[OLD].asymmetry, people[OLD].wrinkles)
    np.testing.assert_array_equal(lines, paint_lines(front, people[OLD].asymmetry, people[OLD].wrinkles))
    assert np.abs(lines - paint_lines(front, people[YOUNG].asymmetry, people[YOUNG].wrinkles)).max() > 0.5
    assert lines.min() >= -1.0
    assert lines.max() <= 0.5
    forehead = lines[:, 0].reshape(x.shape)[y[:, 0] > 0.068]
    down, across = np.abs(np.diff(forehead, axis=0)).mean(), np.abs(np.diff(forehead, axis=1)).mean()
    assert down > 2.5 * across  # lines lie level
    brow = lines[:, 1].reshape(x.shape)[(y[:, 0] > 0.052) & (y[:, 0] < 0.07)][:, np.abs(x[0]) < 0.012]
    assert np.abs(np.diff(brow, axis=1)).mean() > 2.0 * np.abs(np.diff(brow, axis=0)).mean()  # and stand between the brows
    cheek = bump(front, (0.030, 0.006, 0.10), (0.004, 0.003, 0.1)) > 0.5
    assert np.abs(lines[cheek]).mean() < 0.2


@pytest.fixture(scope="module")
def lashes(head, people) -> tuple[Lashes, np.ndarray, np.ndarray]:
    """Lashes, their points as grown [N, K, 3], and the neutral head."""
    subject = people[YOUNG]
    neutral = np.asarray(head.vertices(subject.shape, np.zeros(1), np.zeros((5, 3))), float)
    groom = make_groom(head, RenderMesh.build(head), neutral, subject, share=0.002)
    own = groom.select(groom.groups == LASHES)
    points = own.posed(own.frames(head.v_template, head.faces), neutral)
    return Lashes.build(head, neutral, own), points.reshape(len(own), -1, 3), neutral


def test_lashes_of_open_eyes_are_those_of_the_strands(lashes):
    built, points, neutral = lashes
    np.testing.assert_allclose(built.points(neutral), points, atol=1e-6)


def test_lashes_of_shut_eyes_stand_on_the_seam(head, people, lashes):
    built, _, neutral = lashes
    expression = np.zeros(head.expression_dirs.shape[-1])
    expression[: len(ARKIT_NAMES)] = coefficients("eyeBlink")
    shut = np.asarray(head.vertices(people[YOUNG].shape, expression, np.zeros((5, 3))), float)
    open_points, points = built.points(neutral), built.points(shut)
    upper = built.upper
    for side in (1, -1):
        seam = shut[built.seams[side]]
        order = np.argsort(seam[:, 0])
        roots = points[upper & (built.sides == side), 0]
        assert (roots[:, 1] - np.interp(roots[:, 0], seam[order, 0], seam[order, 1])).min() > -0.0005
    middle = upper & (np.abs(np.abs(open_points[:, 0, 0]) - 0.029) < 0.006)
    assert (points[middle, 0, 1] < open_points[middle, 0, 1] - 0.004).all()  # they come down with the lid
    forward = points[middle, -1, 2] - points[middle, 0, 2]
    assert forward.min() > -0.0002  # metres: and point forward, out of the skin
    assert (forward > 0.0).sum() >= len(forward) - 1  # as they are drawn at random, one may curl up
    assert (points[middle, -1, 1] < points[middle, 0, 1]).mean() > 0.9


def test_lashes_follow_a_rigid_motion(lashes):
    built, _, neutral = lashes
    a, b = 0.4, 0.3
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) @ np.array(
        [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    )
    np.testing.assert_allclose(built.points(neutral @ turn.T + 0.1), built.points(neutral) @ turn.T + 0.1, atol=1e-5)
