"""The borders of lips, and colors redrawn along them."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.head import load_open_head
from grmm_core.head.lip_border import lip_borders
from grmm_core.model.layout import texel_layout
from grmm_core.model.lip_line import lip_line, redrawn
from grmm_core.session import make_local_session


@pytest.fixture(scope="module")
def painted():
    """A layout, the places of its texels on the template, and lips painted by the vertex that is nearest."""
    head = load_open_head()
    layout = texel_layout(head.uv, head.uv_faces, 512)
    corners = head.faces[layout.face]
    places = np.einsum("nk,nkx->nx", layout.barycentric, head.v_template[corners])
    nearest = corners[np.arange(len(corners)), layout.barycentric.argmax(1)]
    colors = np.where(head.marked("lips")[nearest][:, None], (0.8, 0.4, 0.4), (0.9, 0.7, 0.6)).astype(np.float32)
    return head, layout, places, colors


def test_borders_go_through_the_landmarks_and_are_alike_on_both_sides():
    head = load_open_head()
    upper, lower = lip_borders(head)
    marks = head.landmark_positions(head.v_template, 478).astype(float)
    for border, own, middle in ((upper, [40, 37, 0, 267, 270], 0), (lower, [91, 84, 17, 314, 321], 17)):
        np.testing.assert_allclose(border.points * (-1, 1, 1), border.points[::-1], atol=1e-6)
        assert np.abs(border.beyond(marks[own])).max() < 8e-4, "metres; landmarks are not alike on both sides"
        beyond = border.beyond(marks[[middle]] + [0.0, border.up * 0.002, 0.0])
        np.testing.assert_allclose(beyond, 0.002, atol=5e-4)
    bow = upper.points[40, 1] - upper.points[np.abs(upper.points[:, 0] - 0.007).argmin(), 1]
    assert -0.002 < bow < -0.0005


def test_painted_regions_become_lips_with_borders_and_all_else_stays(painted):
    head, layout, places, colors = painted
    line, (upper, lower) = lip_line(head, layout), lip_borders(head)
    np.testing.assert_allclose(line.kept[:, 0] + line.weights.sum((1, 2)), 1.0, atol=1e-5)
    drawn = redrawn(colors, line)
    others = np.setdiff1d(np.arange(len(colors)), line.rows)
    np.testing.assert_array_equal(drawn[others], colors[others])
    assert (np.abs(places[line.rows, 0]) < 0.023).all()
    redness = (0.7 - np.stack([colors, drawn])[..., 1]) / 0.3  # 1 on lips
    for border in (upper, lower):
        beyond = border.beyond(places)
        whole = line.rows[(line.kept[:, 0] < 1e-3) & (np.abs(places[line.rows, 0]) < 0.014)]
        rows = whole[(np.abs(beyond[whole]) > 0.0009) & (np.abs(beyond[whole]) < 0.0024)]
        wrong = np.abs(redness[:, rows] - (beyond[rows] < 0.0))
        assert wrong[0].mean() > 0.03, "the region reaches beyond"
        assert wrong[1].mean() < 0.02


def test_tensors_are_redrawn_like_arrays(painted):
    torch = pytest.importorskip("torch")
    head, layout, _, colors = painted
    line = lip_line(head, layout)
    tensors = type(line)(*(torch.as_tensor(array) for array in line))
    values = torch.as_tensor(np.stack([colors, 1.0 - colors])).requires_grad_()
    drawn = redrawn(values, tensors)
    np.testing.assert_allclose(
        drawn.detach().numpy(), np.stack([redrawn(colors, line), redrawn(1.0 - colors, line)]), atol=1e-6
    )
    (gradient,) = torch.autograd.grad(drawn.sum(), values)
    np.testing.assert_allclose(gradient.sum().item(), values.numel(), rtol=1e-4)


def test_a_model_that_a_session_has_drawn_can_still_be_fitted():
    torch = pytest.importorskip("torch")
    with make_local_session(engine="torch") as session:
        model = session.engine.store.default().model
        view = torch.tensor([0.0, 0.0, 1.0])
        with torch.inference_mode():
            model.appearance(torch.zeros(model.z_id_size), view)
        code = torch.zeros(model.z_id_size, requires_grad=True)
        model.appearance(code, view)[0].sum().backward()
        assert float(code.grad.abs().max()) > 0.0
