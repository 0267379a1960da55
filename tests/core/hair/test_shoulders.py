"""Long hair of a head that turns: it hangs, out of the shoulders, as long as before, a function of the pose, without jumps."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.hair import library_groom
from grmm_core.hair.body import Body, worn
from grmm_core.hair.contact import rigid_motion
from grmm_core.hair.pigment import locks_of
from grmm_core.hair.roots import SCALP
from grmm_core.hair.shoulders import Shoulders
from grmm_core.head import load_open_head

SUNK = 0.003  # metres


@pytest.fixture(scope="module")
def head():
    return load_open_head()


class Worn:
    """A packaged groom on the mean's skin."""

    def __init__(self, head, name: str, share: float = 0.1) -> None:
        self.head, rest = head, np.asarray(head.v_template, float)
        groom = library_groom(name)
        self.groom = worn(head, rest, groom.select(groom.groups == SCALP).level(share))
        self.frames = self.groom.frames(rest, head.faces)
        self.shoulders = Shoulders.of(head, rest, self.followed(rest), locks_of(self.groom, rest, head.faces))

    def posed(self, nod: float = 0.0, yaw: float = 0.0, tilt: float = 0.0) -> np.ndarray:
        pose = np.zeros((5, 3))
        pose[1] = nod, yaw, tilt
        return np.asarray(self.head.vertices(np.zeros(300), np.zeros(1), pose), float)

    def followed(self, vertices: np.ndarray) -> np.ndarray:
        return self.groom.posed(self.frames, vertices).reshape(len(self.groom), -1, 3).astype(np.float32)

    def sunk(self, vertices: np.ndarray, strands: np.ndarray) -> float:
        """Share of the points beside the shoulders that are inside of them."""
        points = strands[:, 2:].reshape(-1, 3)
        heights = Body.of(self.head, vertices, below=-0.02).heights(points[points[:, 1] < -0.03])[0]
        return float((heights < -SUNK).mean())


@pytest.fixture(scope="module")
def long(head) -> Worn:
    return Worn(head, "long")


@pytest.mark.parametrize("turn", [{"yaw": 0.58}, {"nod": -0.35}, {"nod": 0.3, "yaw": 0.4, "tilt": 0.2}])
def test_strands_are_out_of_the_shoulders_and_as_long_as_before(long, turn):
    vertices = long.posed(**turn)
    before = long.followed(vertices)
    after = long.shoulders[0].left(vertices, before)
    assert long.sunk(vertices, before) > 0.02
    assert long.sunk(vertices, after) < 1e-3
    np.testing.assert_array_equal(after[:, 0], before[:, 0])
    ratio = np.divide(*(np.linalg.norm(np.diff(part, axis=1), axis=2).sum(1) for part in (after, before)))
    assert ratio.max() < 1.02
    assert np.percentile(ratio, 1) > 0.85


def test_an_upright_head_and_short_hair_are_left_alone(long, head):
    rest = long.posed()
    strands = long.followed(rest)
    assert long.shoulders[0].left(rest, strands) is strands
    assert Worn(head, "crop").shoulders == ()


def leaning(strands: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Degrees between the last quarter of some strands and the vertical, [M]."""
    way = strands[rows, -1] - strands[rows, -1 - strands.shape[1] // 4]
    return np.degrees(np.arccos((-way[:, 1] / np.linalg.norm(way, axis=1)).clip(-1.0, 1.0)))


@pytest.mark.parametrize("turn", [{"nod": 0.3}, {"nod": -0.3}, {"tilt": 0.35}, {"nod": 0.2, "yaw": 0.4, "tilt": -0.2}])
def test_long_hair_of_a_tilted_head_hangs_down(long, turn):
    rest, vertices = long.followed(long.posed()), long.posed(**turn)
    before = long.followed(vertices)
    after = long.shoulders[0].left(vertices, before)
    in_air = Body.of(long.head, vertices, below=-0.02).heights(after[:, -1])[0] > 0.01
    rows = np.flatnonzero(in_air & (rest[:, -1, 1] < -0.09))
    assert len(rows) > 20
    upright, leant, hanging = (float(np.median(leaning(strands, rows))) for strands in (rest, before, after))
    assert leant > upright + 6.0, "it followed the head"
    assert abs(hanging - upright) < 4.0


def test_a_person_who_lies_down_wears_hair_alike(long):
    """The root turns bust and head: hair goes with both, however the neck is turned."""
    pose = np.zeros((5, 3))
    pose[0, 2], pose[1, 2] = 1.2, 0.3
    lying = np.asarray(long.head.vertices(np.zeros(300), np.zeros(1), pose), float)
    sitting = long.posed(tilt=0.3)
    turn, shift = rigid_motion(lying, sitting)
    there, here = (long.shoulders[0].left(vertices, long.followed(vertices)) for vertices in (lying, sitting))
    np.testing.assert_allclose(there @ turn.T + shift, here, atol=2e-3)  # a strand that a millimetre decides about


@pytest.mark.parametrize("turn", ["yaw", "nod", "tilt"])
def test_nothing_jumps_while_a_head_turns(long, turn):
    moves = []
    for angle in np.linspace(0.0, 0.5, 26):
        vertices = long.posed(**{turn: angle})
        followed = long.followed(vertices)
        moves.append(long.shoulders[0].left(vertices, followed) - followed)
    steps = np.abs(np.diff(moves, axis=0)).max((1, 2, 3))
    assert np.max(np.abs(moves)) > 0.02
    assert steps.max() < 0.008  # beside 10 mm that tips move a step themselves


def test_any_first_part_of_the_strands_is_brought_out_alike(long):
    vertices = long.posed(yaw=0.5)
    strands = long.followed(vertices)
    some = long.shoulders[0].left(vertices, strands[:200])
    np.testing.assert_allclose(some, long.shoulders[0].left(vertices, strands)[:200], atol=2e-5)


def test_the_compiled_kernel_does_what_its_twin_does(long):
    vertices = long.posed(yaw=0.5)
    strands = long.followed(vertices)
    fast, slow = (long.shoulders[0].left(vertices, strands, compiled) for compiled in (True, False))
    off = np.abs(fast - slow).max(2)
    assert (off < 3e-4).mean() > 0.995
    assert off.max() < 0.005


@pytest.mark.parametrize("name", ["jawOpen", "browInnerUp", "mouthStretchLeft"])
def test_faces_do_not_move_shoulders(head, long, name):
    expression = np.zeros(len(head.expression_names))
    expression[list(head.expression_names).index(name)] = 1.0
    vertices = np.asarray(head.vertices(np.zeros(300), expression, head.pose_of(expression, np.zeros((5, 3)))), float)
    before = long.followed(vertices)
    assert long.shoulders[0].left(vertices, before) is before
