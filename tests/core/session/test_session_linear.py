"""The session's scene-linear pass, which the render engine takes: the same light as the display picture, in both sessions."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.geometry.camera import Camera
from grmm_core.pictures.color import scene_linear_premultiplied
from grmm_core.session import Instance, RenderOptions, create_session
from grmm_core.session.values import LINEAR_PASS, RAW_LINEAR_PASS

CAMERA = Camera.orbit(96, 96)
CLOSE = {"rtol": 0.0, "atol": 5e-6}
RED = (1.0, 0.0, 0.0)


@pytest.fixture(scope="module", params=[("local", "torch"), ("worker", "plain")], ids=["torch", "plain"])
def session(request, tmp_path_factory):
    from tiny_model import write_tiny_weights

    weights = write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")
    mode, engine = request.param
    with create_session(mode, weights=weights, device="cpu", threads=1, engine=engine) as session:
        yield session


@pytest.mark.parametrize("refine", [True, False])
def test_scene_linear_pass_is_the_picture_in_linear_light(session, refine):
    instances = [Instance(session.open("default").id)]
    found = session.render(
        instances, CAMERA, RenderOptions(refine=refine, passes=(LINEAR_PASS, RAW_LINEAR_PASS, "raw", "rgb", "alpha"))
    )
    assert found[LINEAR_PASS].shape == (96, 96, 4)
    assert found[LINEAR_PASS].dtype == np.float32
    assert found["alpha"].max() > 0.9
    np.testing.assert_allclose(found[LINEAR_PASS], scene_linear_premultiplied(found["rgb"], found["alpha"]), **CLOSE)
    np.testing.assert_allclose(found[RAW_LINEAR_PASS], scene_linear_premultiplied(found["raw"], found["alpha"]), **CLOSE)
    # alone, and whatever is behind
    alone = session.render(instances, CAMERA, RenderOptions(refine=refine, passes=(LINEAR_PASS,), background=RED))
    np.testing.assert_allclose(alone[LINEAR_PASS], found[LINEAR_PASS], **CLOSE)


def test_nothing_is_nothing_in_linear_light_too(session):
    empty = session.render([], CAMERA, RenderOptions(passes=(LINEAR_PASS,)))
    assert empty[LINEAR_PASS].shape == (96, 96, 4)
    assert empty[LINEAR_PASS].max() == 0.0
    away = Camera.orbit(96, 96, distance=1.0)
    behind = session.render([Instance(session.open("default").id, model_to_world=_moved(-3.0))], away,
                            RenderOptions(passes=(LINEAR_PASS,)))  # fmt: skip
    assert behind[LINEAR_PASS].max() == 0.0


def _moved(x: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix
