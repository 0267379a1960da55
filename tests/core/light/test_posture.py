"""How a posed head lies beside itself at rest: by its neck, whatever the face does."""

from __future__ import annotations

import numpy as np
import pytest
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields

from grmm_core.controls.names import JOINT_NAMES
from grmm_core.head import load_flame, load_open_head
from grmm_core.light.lamps import Sun
from grmm_core.light.posture import Posture

TURN = np.array([[0.0, 0.05, 0.0], [0.2, -0.5, 0.1], [0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.1, 0.2, 0.0]])
STILL = np.zeros((5, 3))


@pytest.fixture(scope="module", params=["open", "flame"])
def head(request, tmp_path_factory):
    if request.param == "open":
        return load_open_head()
    path = tmp_path_factory.mktemp("flame") / "flame2023.pkl"
    write_flame_pickle(path, flame_head_fields())
    return load_flame(path)


def test_an_expression_is_no_turn(head):
    """Else every shadow in hair would be made anew for lifted brows, which pull at the scalp."""
    shape, pose = np.random.default_rng(0).normal(size=20), STILL.copy()
    pose[2:, 0] = 0.3  # jaw and eyes
    posture = Posture(head, shape, STILL, pose, head.vertices(shape, np.zeros(0), STILL))
    np.testing.assert_array_equal(posture.turn, np.eye(3))
    np.testing.assert_array_equal(posture.to_rest, np.eye(4))
    lamp = Sun()
    assert posture.moved(lamp, posture.to_rest) == lamp


def test_the_skull_goes_back_to_where_it_rests(head):
    shape = np.random.default_rng(0).normal(size=20)
    rest, posed = (head.vertices(shape, np.zeros(0), pose) for pose in (STILL, TURN))
    posture = Posture(head, shape, STILL, TURN, rest)
    back = posed @ posture.to_rest[:3, :3].T + posture.to_rest[:3, 3]
    skull = head.weights[:, JOINT_NAMES.index("neck")] > 0.999
    assert np.linalg.norm(posed - rest, axis=1)[skull].mean() > 0.02
    assert np.linalg.norm(back - rest, axis=1)[skull].max() < 0.002  # FLAME bends a little more where a joint turns
    np.testing.assert_allclose(posture.turn, posture.to_rest[:3, :3].T, atol=2e-5)
