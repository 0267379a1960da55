"""Furrows of an expression in pictures, for both engines."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.frame import Controls
from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.errors import ConfigError
from grmm_core.geometry.camera import Camera
from grmm_core.light.lamps import Lighting, Sun
from grmm_core.light.shading import Response
from grmm_core.session import HairUse, Instance, RenderOptions, create_session

CAMERA = Camera.orbit(192, 192, 0, 5, fov=13)
BALD = HairUse("none", brows="none", beard="none", lashes="none")


@pytest.fixture(scope="module", params=["torch", "plain"])
def session(request):
    with create_session("local", engine=request.param) as session:
        yield session


def face(**weights):
    aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
    for name, weight in weights.items():
        aligned[ALIGNED_NAMES.index(name)] = weight
    return Controls(aligned=aligned)


BROWS = face(browInnerUp=1.0, browOuterUpLeft=1.0, browOuterUpRight=1.0)


def drawn(session, controls, wrinkles, lighting=None, camera=CAMERA):
    response = None if lighting is None else Response()
    placed = Instance(session.open("default").id, controls, hair=BALD, response=response, wrinkles=wrinkles)
    options = RenderOptions(passes=("rgb", "raw", "alpha", "depth"), lighting=lighting)
    return session.render([placed], camera, options)


def test_a_face_at_rest_has_none(session):
    for name, array in drawn(session, Controls(), 0.0).items():
        np.testing.assert_array_equal(drawn(session, Controls(), 2.0)[name], array, err_msg=name)


def test_lifted_brows_furrow_the_forehead_and_nothing_else(session):
    smooth, furrowed = drawn(session, BROWS, 0.0), drawn(session, BROWS, 1.0)
    changed = np.abs(furrowed["rgb"] - smooth["rgb"]).max(-1)
    rows, columns = np.nonzero(changed > 0.02)
    assert len(rows) > 300
    height, width = changed.shape
    assert rows.max() < 0.5 * height  # the forehead is above the eyes
    assert abs(columns.mean() - width / 2) < 0.06 * width
    down = (furrowed["rgb"] - smooth["rgb"]).mean(-1)[:, width // 2 - 10 : width // 2 + 10].mean(1)
    assert (down < -0.01).any()
    assert (down > 0.005).any()
    for name in ("raw", "alpha", "depth"):
        np.testing.assert_array_equal(furrowed[name], smooth[name])


def test_they_grow_with_the_slider_and_the_expression(session):
    def strength(controls, wrinkles):
        return np.abs(drawn(session, controls, wrinkles)["rgb"] - drawn(session, controls, 0.0)["rgb"]).sum()

    half = face(browInnerUp=0.5, browOuterUpLeft=0.5, browOuterUpRight=0.5)
    assert 0.2 * strength(BROWS, 1.0) < strength(half, 1.0) < strength(BROWS, 1.0) < strength(BROWS, 2.0)


def test_one_brow_furrows_its_own_side(session):
    left = face(browOuterUpLeft=1.0)
    changed = np.abs(drawn(session, left, 1.0)["rgb"] - drawn(session, left, 0.0)["rgb"]).sum(-1)
    middle = changed.shape[1] // 2
    assert changed[:, middle:].sum() > 4.0 * changed[:, :middle].sum()  # the person's left is the picture's right


def test_a_lamp_from_above_darkens_what_looks_down(session):
    """Where a lamp from below makes a slope bright, one from above makes it dark."""

    def change(height):
        lamp = Lighting((Sun(direction=(0.0, height, 1.0), strength=3.0),))
        return (drawn(session, BROWS, 1.0, lamp)["rgb"] - drawn(session, BROWS, 0.0, lamp)["rgb"]).mean(-1)

    above, below = change(1.0), change(-1.0)
    strong = np.maximum(np.abs(above), np.abs(below)) > 0.02
    assert np.corrcoef(above[strong], below[strong])[0, 1] < 0.3


def test_both_engines_draw_the_same():
    pictures = []
    for engine in ("torch", "plain"):
        with create_session("local", engine=engine) as one:
            pictures.append(drawn(one, BROWS, 1.0)["rgb"])
    assert np.abs(pictures[0] - pictures[1]).max() < 1.5 / 255


@pytest.mark.parametrize("factor", [-0.1, 5.0, float("nan")])
def test_a_factor_out_of_range_is_refused(factor):
    with pytest.raises(ConfigError, match="wrinkles"):
        Instance(0, wrinkles=factor)
