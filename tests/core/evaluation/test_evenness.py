"""How much light is left in a face: none of one tone in the rig, what a lamp adds, and marks are no light."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.frame import Controls
from grmm_core.evaluation.cleanliness import Shot
from grmm_core.evaluation.evenness import evenness
from grmm_core.head import load_open_head
from grmm_core.light.parse import lighting_of
from grmm_core.light.relight import to_display, to_linear
from grmm_core.light.shading import Response
from grmm_core.model.portrait import portrait_camera
from grmm_core.session import Instance, RenderOptions, create_session


@pytest.fixture(scope="module")
def person():
    """Draws the bald library avatar in a light, as a `Shot`."""
    with create_session("local") as session:
        number = session.open("library:bald").id

        def draw(*lights: str, yaw: float = 0.0) -> Shot:
            camera = portrait_camera(256, yaw)
            options = RenderOptions(passes=("rgb", "alpha"), lighting=lighting_of(lights) if lights else None)
            drawn = session.render([Instance(number, Controls(), response=Response())], camera, options)
            alpha = drawn["alpha"][..., 0]
            vertices = np.asarray(session.deform(number, Controls()).vertices, np.float64)
            return Shot(vertices, camera, drawn["rgb"], alpha, np.zeros_like(alpha))

        yield draw


def test_a_person_of_the_studio_is_evenly_lit_in_its_rig_and_unevenly_beside_a_lamp(person):
    head, even = load_open_head(), person()
    assert evenness(even.rgb, even, head).spread < 0.08
    for light, name in (("lamp:50,10,40", "aside"), ("lamp:0,60,40", "up")):
        lit = evenness(person(light, "world:0.2").rgb, even, head)
        assert lit.spread > 0.25, light
        assert getattr(lit, name) > 1.5, light
    assert evenness(person("lamp:-50,10,40", "world:0.2").rgb, even, head).aside < 1 / 1.5


def test_exposure_marks_and_the_view_are_no_light(person):
    head, even = load_open_head(), person()
    found = evenness(even.rgb, even, head)
    darker = to_display(0.5 * to_linear(even.rgb.astype(np.float64)))
    np.testing.assert_allclose(evenness(darker, even, head), found, atol=0.02)
    marked, row = even.rgb.copy(), np.arange(256)[:, None, None]
    marked[np.broadcast_to(row % 32 < 3, marked.shape)] *= 0.6  # dark stripes, a tenth of the skin
    assert abs(evenness(marked, even, head).spread - found.spread) < 0.02
    aside = person(yaw=25.0)
    assert evenness(aside.rgb, aside, head).spread < 0.1
