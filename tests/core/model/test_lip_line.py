"""The border of the upper lip, and colors redrawn along it."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.head import load_open_head
from grmm_core.head.lip_border import upper_lip, whole_lips
from grmm_core.model.layout import texel_layout
from grmm_core.model.lip_line import lip_line, redrawn


@pytest.fixture(scope="module")
def painted():
    """A layout, the places of its texels on the template, and lips painted in steps: by the vertex that is nearest."""
    head = load_open_head()
    layout = texel_layout(head.uv, head.uv_faces, 512)
    corners = head.faces[layout.face]
    places = np.einsum("nk,nkx->nx", layout.barycentric, head.v_template[corners])
    nearest = corners[np.arange(len(corners)), layout.barycentric.argmax(1)]
    colors = np.where(head.marked("lips")[nearest][:, None], (0.8, 0.4, 0.4), (0.9, 0.7, 0.6)).astype(np.float32)
    return head, layout, places, colors


def test_lips_are_one_piece_and_their_border_is_alike_on_both_sides():
    head = load_open_head()
    added = head.v_template[whole_lips(head) & ~head.marked("lips")]
    assert len(added) == 2
    border = upper_lip(head)
    np.testing.assert_allclose(border.points * (-1, 1, 1), border.points[::-1], atol=1e-4)
    middle = np.abs(border.points[:, 0]) < 0.012
    assert np.ptp(border.points[middle, 1]) < 0.0015  # without the gaps, which are as deep as that
    np.testing.assert_allclose(border.beyond(border.points + np.array([0.0, 0.001, 0.0]))[20:-20], 0.001, rtol=0.2)


def test_steps_become_a_smooth_line_and_all_else_stays(painted):
    head, layout, places, colors = painted
    line = lip_line(head, layout)
    np.testing.assert_allclose(line.kept[:, 0] + line.weights.sum((1, 2)), 1.0, atol=1e-5)
    drawn, border = redrawn(colors, line), upper_lip(head)
    others = np.setdiff1d(np.arange(len(colors)), line.rows)
    np.testing.assert_array_equal(drawn[others], colors[others])
    assert (np.abs(places[line.rows, 0]) < 0.022).all()
    beyond = border.beyond(places)
    redness = (0.7 - np.stack([colors, drawn])[..., 1]) / 0.3  # 1 on lips
    rows = line.rows[(line.kept[:, 0] == 0.0) & (np.abs(places[line.rows, 0]) < 0.014)]
    wrong = np.abs(redness[:, rows] - (beyond[rows] < 0.0))
    clear = np.abs(beyond[rows]) > 0.0009
    assert wrong[0, clear].mean() > 0.03, "steps"
    assert wrong[1, clear].max() < 0.02


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
