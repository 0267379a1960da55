"""A head that is tilted in a photo: it stays where it is, on an upright bust, and its hair hangs at rest as hair does."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from grmm_core.avatar import Hair
from grmm_core.fitting.tilt import NECK, hung_free, upright
from grmm_core.fitting.types import PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.contact import rigid_motion
from grmm_core.hair.groom import bind, join
from grmm_core.hair.pigment import locks_of
from grmm_core.hair.roots import SCALP
from grmm_core.hair.shoulders import Shoulders
from grmm_core.head import load_open_head
from grmm_core.photo.parser import LABELS

SIDE = 64


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def rolled(degrees: float, yaw: float = 20.0) -> Camera:
    """A camera before the head, in whose picture the head is tilted clockwise."""
    camera = Camera.orbit(SIDE, SIDE, yaw, 5.0)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    roll = np.eye(4)
    roll[:2, :2] = [[c, -s], [s, c]]
    return dataclasses.replace(camera, world_to_camera=roll @ camera.world_to_camera)


def track_of(head, camera: Camera) -> PhotoTrack:
    shape = np.random.default_rng(0).normal(size=head.shape_count) * 0.5
    plane, points = np.ones((SIDE, SIDE)), np.full((478, 2), SIDE / 2.0)
    return PhotoTrack(
        source="", image=np.full((SIDE, SIDE, 3), 0.5), mask=plane, valid=plane, camera=camera,
        photo_camera=camera.resized(2 * SIDE, 2 * SIDE), shape=shape, expression=np.zeros(head.expression_count),
        pose=np.zeros((5, 3)), landmarks=points, landmarks_fitted=points, arkit=np.zeros(52),
        labels=np.zeros((len(LABELS), SIDE, SIDE)),
    )  # fmt: skip


def shown(track: PhotoTrack, head) -> np.ndarray:
    """Where the vertices are in the picture, [V, 2]."""
    return track.camera.project(head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose)))[1]


@pytest.mark.parametrize("degrees", [-30.0, 4.0, 25.0])
def test_the_head_stays_where_it_is_and_the_bust_stands_up(head, degrees):
    before = track_of(head, rolled(degrees))
    after = upright(before, head)
    face, bust = head.marked("face") & (head.weights[:, 0] < 1e-3), head.weights[:, 0] > 0.999
    were, are = shown(before, head), shown(after, head)
    np.testing.assert_allclose(are[face], were[face], atol=0.02)
    np.testing.assert_allclose(after.head_down, before.head_down, atol=1e-6)
    assert np.linalg.norm(are[bust] - were[bust], axis=1).mean() > 0.1 * abs(degrees)
    right, down = after.camera.world_to_camera[:2, 1]
    assert abs(right) < 1e-6
    assert down < 0.0
    scale = after.photo_camera.fx / after.camera.fx
    np.testing.assert_allclose(after.photo_camera.world_to_camera, after.camera.world_to_camera)
    assert scale == pytest.approx(2.0)
    assert not after.pose[[0, 2, 3, 4]].any()


def test_a_head_that_lies_and_a_neck_that_is_known_are_left_alone(head):
    lying = track_of(head, rolled(80.0))
    assert upright(lying, head) is lying
    known = upright(track_of(head, rolled(20.0)), head)
    assert upright(known, head) is known


@pytest.mark.parametrize("degrees", [-25.0, 25.0])
def test_hair_that_hung_beside_a_tilted_head_hangs_straight_at_rest(head, degrees):
    rest, faces = np.asarray(head.v_template, float), head.faces
    truth = library_groom("long")
    truth = truth.select(truth.groups == SCALP).level(0.1)
    track = upright(dataclasses.replace(track_of(head, rolled(degrees, yaw=0.0)), shape=np.zeros(head.shape_count)), head)
    posed = head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose)).astype(float)
    frames = truth.frames(rest, faces)
    strands = truth.posed(frames, rest).reshape(len(truth), -1, 3).astype(np.float32)
    followed = truth.posed(frames, posed).reshape(strands.shape).astype(np.float32)
    (shoulders,) = Shoulders.of(head, rest, strands, locks_of(truth, rest, faces))
    photographed = shoulders.left(posed, followed)
    scalp = np.asarray(head.regions["scalp"])
    turn, shift = rigid_motion(posed[scalp], rest[scalp])
    along = (photographed @ turn.T + shift).reshape(-1, 3)  # as if it went along with the head
    fitted = bind(rest, faces, rest, truth.triangles, truth.weights, along, truth.offsets, truth.widths, truth.groups)
    brows = library_groom("thin", part="brows")
    found = hung_free(Hair(join([fitted, brows]), HairSettings()), [track], head).groom
    again = found.select(found.groups == SCALP).posed(frames, rest).reshape(strands.shape)
    beside, along = strands[:, -1, 0] * np.sign(degrees), along.reshape(strands.shape)
    low = (beside > 0.06) & (strands[:, -1, 1] < -0.1)  # clockwise in the picture is to the subject's left
    wrong, left = (np.median(np.linalg.norm(part[low, -1] - strands[low, -1], axis=1)) for part in (along, again))
    assert low.sum() > 50
    assert wrong > 0.02
    assert left < 0.5 * wrong, "the shoulder holds some of it up"
    high = beside < -0.06
    wrong, left = (np.median(np.linalg.norm(part[high] - strands[high], axis=2)) for part in (along, again))
    assert left < wrong + 0.002, "on the other side the neck has held it"
    np.testing.assert_array_equal(found.points[-len(brows.points) :], brows.points)
    assert hung_free(None, [track], head) is None


def test_the_turn_of_the_neck_is_the_tilt(head):
    for degrees in (-20.0, 15.0):
        pose = upright(track_of(head, rolled(degrees, yaw=0.0)), head).pose
        assert np.degrees(pose[NECK, 2]) == pytest.approx(-degrees, abs=0.5), "to the subject's left is a negative turn about z"
