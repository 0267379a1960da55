"""Soft tissue: nothing in the neutral face, the same again, different from person to person, lids and lips as they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.head.open_head import load_people_model
from grmm_studio.flesh import Flesh
from grmm_studio.mesh import region_vertices
from grmm_studio.subjects import Subject, draw_subject

POSE = np.zeros((5, 3))


@pytest.fixture(scope="module")
def people() -> list[Subject]:
    return [draw_subject(5, index, load_people_model()) for index in (0, 20)]


def coefficients(head, **weights: float) -> np.ndarray:
    """Expression with both sides of the named shapes, [E]."""
    values = np.zeros(head.expression_dirs.shape[-1])
    for name, weight in weights.items():
        for full in (name, name + "Left", name + "Right"):
            if full in ARKIT_NAMES:
                values[ARKIT_NAMES.index(full)] = weight
    return values


@pytest.fixture(scope="module")
def move(head, render_mesh):
    """(person, expression, pose) -> displacement, [V, 3]."""

    def of(subject: Subject, expression: np.ndarray, pose: np.ndarray = POSE) -> np.ndarray:
        neutral = np.asarray(head.vertices(subject.shape, np.zeros(1), POSE), float)
        posed = np.asarray(head.vertices(subject.shape, expression, pose), float)
        flesh = Flesh(subject, head, neutral)
        return flesh.displacement(posed, render_mesh.normals(posed), expression, pose)

    return of


def full_pose(head, expression: np.ndarray, **joints: tuple[float, float, float]) -> np.ndarray:
    pose = np.einsum("e,ejk->jk", expression, np.asarray(head.expression_pose, float))
    for name, angles in joints.items():
        pose[head.joint_names.index(name)] += angles
    return pose


def test_the_neutral_face_has_none(head, people, move):
    np.testing.assert_array_equal(move(people[0], coefficients(head)), 0.0)


def test_it_is_repeatable_personal_and_moderate(head, people, move):
    smile = coefficients(head, mouthSmile=1.0, cheekSquint=0.5)
    a, again, b = move(people[0], smile), move(people[0], smile), move(people[1], smile)
    np.testing.assert_array_equal(a, again)
    assert np.abs(a - b).max() > 0.0005
    for expression in (smile, *np.eye(len(smile))[: len(ARKIT_NAMES)]):
        length = np.linalg.norm(move(people[0], expression, full_pose(head, expression)), axis=1)
        assert length.max() < 0.009
        assert np.isfinite(length).all()
    assert np.linalg.norm(a, axis=1).max() > 0.0015


def test_eyes_and_teeth_stay(head, people, move):
    expression = coefficients(head, mouthSmile=1.0, jawOpen=0.7, browDown=1.0)
    moved = move(people[0], expression, full_pose(head, expression))
    for name in ("left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue"):
        assert not moved[region_vertices(head, name)].any()


def test_combinations_are_not_sums(head, people, move):
    both, one, other = (
        move(people[0], coefficients(head, **weights))
        for weights in ({"browDown": 1.0, "browInnerUp": 1.0}, {"browDown": 1.0}, {"browInnerUp": 1.0})
    )
    assert np.linalg.norm(both - one - other, axis=1).max() > 0.0005


def test_it_turns_with_the_head(head, people, move, render_mesh):
    expression = coefficients(head, mouthSmile=1.0, browInnerUp=1.0)
    still = move(people[0], expression)
    turned = move(people[0], expression, full_pose(head, expression, neck=(0.0, 0.5, 0.0)))
    upper = np.asarray(head.v_template)[:, 1] > 0.03
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    np.testing.assert_allclose(turned[upper], still[upper] @ turn.T, atol=3e-4)


def test_upper_lids_go_down_with_the_eye(head, people, move):
    pose = POSE.copy()
    pose[3:, 0] = 0.4
    moved = move(people[0], coefficients(head), pose)
    lids = region_vertices(head, "lids")
    margin = lids[np.asarray(head.v_template)[lids, 1] > 0.037]
    assert moved[margin, 1].min() < -0.002
    shut = move(people[0], coefficients(head, eyeBlink=1.0), pose)
    assert shut[margin, 1].min() > moved[margin, 1].min()


def test_lips_stick_in_the_corners_first(head, people, move):
    subject = replace(people[0], asymmetry=4)
    expression = coefficients(head, jawOpen=0.25)
    moved = move(subject, expression, full_pose(head, expression))
    lips = region_vertices(head, "lips")
    x = np.abs(np.asarray(head.v_template)[lips, 0])
    corner, middle = (np.linalg.norm(moved[lips[own]], axis=1).max() for own in (x > 0.014, x < 0.006))
    assert corner > 2 * middle
    # they come nearer to each other
    upper = lips[np.argmax(np.where(x > 0.014, -moved[lips, 1], -1))]
    assert moved[upper, 1] < 0
