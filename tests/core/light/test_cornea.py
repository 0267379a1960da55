"""The cornea bulges beyond the ball that an eye's mesh is."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.head import load_open_head
from grmm_core.light.cornea import EYEBALLS, bulged, catchlight
from grmm_core.light.transfer import vertex_normals


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def normals_of(head, vertices):
    every = np.arange(len(vertices))
    before = vertex_normals(vertices, head.faces)
    return before, bulged(head, vertices, np.repeat(every[:, None], 3, 1), before)


def from_pole(normals, axis):
    return np.arccos(np.clip(normals @ axis, -1.0, 1.0))


def test_normals_turn_outwards_on_the_iris_and_nowhere_else(head):
    vertices, ahead = np.asarray(head.v_template, float), np.array([0.0, 0.0, 1.0])
    before, after = normals_of(head, vertices)
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), 1.0, atol=1e-6)
    eye = head.regions["left_eyeball"]
    angle, turned = from_pole(before[eye], ahead), from_pole(after[eye], ahead)
    near = (angle > 0.1) & (angle < 0.35)
    assert near.sum() > 5
    np.testing.assert_allclose(
        turned[near] / angle[near], 12.0 / 7.8, rtol=0.12
    )  # the pole is that of the mesh, not quite ahead
    np.testing.assert_allclose(after[eye][angle > 0.75], before[eye][angle > 0.75], atol=1e-6)
    skin = np.setdiff1d(np.arange(len(vertices)), np.concatenate([eye, head.regions["right_eyeball"]]))
    np.testing.assert_array_equal(after[skin], before[skin])


def test_the_cornea_turns_with_the_eye(head):
    rest, eye = np.asarray(head.v_template, float), head.regions["left_eyeball"]
    angle = 0.4
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    posed, middle = rest.copy(), rest[eye].mean(0)
    posed[eye] = (rest[eye] - middle) @ turn.T + middle
    still, moved = normals_of(head, rest)[1], normals_of(head, posed)[1]
    np.testing.assert_allclose(moved[eye], still[eye] @ turn.T, atol=1e-5)


def test_the_catchlight_stands_on_the_iris_toward_the_lamp_and_moves_with_the_viewer(head):
    vertices = np.asarray(head.v_template, float)
    corners = head.faces[head.marked(*EYEBALLS)[head.faces].all(1)]
    # four points on each face: spots are narrower than faces
    weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / [[3], [6], [6], [6]]
    corners, weights = np.repeat(corners, 4, 0), np.tile(weights, (len(corners), 1))
    places = np.einsum("nk,nkx->nx", weights, vertices[corners])

    def spots(*view):
        glint = catchlight(head, vertices, corners, weights, np.array(view) / np.linalg.norm(view))
        return glint, [
            (glint[own, None] * places[own]).sum(0) / glint[own].sum() for own in (places[:, 0] > 0, places[:, 0] < 0)
        ]

    glint, ahead = spots(0.0, 0.0, 1.0)
    assert glint.max() > 0.8
    assert (glint > 0.1).mean() < 0.03
    _, aside = spots(0.5, 0.0, 1.0)
    for name, here, there in zip(EYEBALLS, ahead, aside, strict=True):
        ball = vertices[head.regions[name]]
        pole = ball[ball[:, 2].argmax()]
        assert 0.001 < here[0] - pole[0] < 0.004, "the rig's key lamp stands to the person's left, and above"
        assert 0.0005 < here[1] - pole[1] < 0.004
        assert there[0] > here[0] + 0.001
