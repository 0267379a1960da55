"""Skin where an avatar wears other hair than its own: `grmm_core/session/scalp.py`."""

from types import SimpleNamespace

import numpy as np
import pytest

from grmm_core.session import create_session
from grmm_core.session.scalp import bare_skin

SKIN, HAIR = (0.8, 0.6, 0.5), (0.15, 0.12, 0.1)


@pytest.fixture(scope="module")
def model():
    with create_session("local") as session:
        return session.engine.store.default().model


def test_a_photos_painted_hair_does_not_show_under_another_groom_and_stays_under_its_own(model):
    head, layout = model.head_model, model.layout
    corners = np.asarray(head.faces)[layout.face]
    scalp = (head.marked("scalp").astype(float)[corners] * layout.barycentric).sum(1) > 0.99
    painted = np.where(scalp[:, None], HAIR, SKIN).astype(np.float32)
    evaluator = SimpleNamespace(
        cache=SimpleNamespace(get=lambda key, make: make()), appearance=lambda target, inputs, eye: (painted,)
    )
    target = SimpleNamespace(
        id=1, model=SimpleNamespace(head_model=head, layout=layout, config=SimpleNamespace(hairless=True, position_unit_mm=1.0))
    )
    other, own = (bare_skin(evaluator, target, SimpleNamespace(), own=mine) for mine in (False, True))
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    skin = other.color[~scalp & outer].mean(0)
    np.testing.assert_allclose(other.color[scalp & outer].mean(0), skin, rtol=0.1)
    assert own.color[scalp & outer].mean() < 0.2 * skin.mean()
    np.testing.assert_array_equal(other.color[~scalp], own.color[~scalp])
