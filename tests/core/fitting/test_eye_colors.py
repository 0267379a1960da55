"""Eyes at rest: iris and white in the photo's tones, without lamps in the cornea, lashes and the tracking's last pixel."""

from __future__ import annotations

import pytest
import torch

from grmm_core.fitting.eye_colors import DETAIL, LINE, WHITE_TINT, even_lash_line, eye_angles, plain_eyes
from grmm_core.fitting.lids import lash_line

BLACK, BROWN, WHITE, SKIN = (
    torch.tensor(color) for color in ([0.1, 0.1, 0.1], [0.3, 0.22, 0.16], [0.85, 0.76, 0.72], [0.7, 0.55, 0.45])
)
BLUE = torch.tensor([0.25, 0.35, 0.5])


@pytest.fixture(scope="module")
def angles(bare):
    return eye_angles(bare)


@pytest.fixture(scope="module")
def decoded(angles):
    """Brown eyes amid skin."""
    colors = SKIN.repeat(len(angles), 1)
    colors[angles < 90.0] = WHITE
    colors[angles < 23.0] = BROWN
    colors[angles < 9.0] = BLACK
    return colors


def shown_blue(angles, decoded):
    """What a photo shows of blue-eyed people: a lamp over the pupil, a lash here and there, the iris a little beside."""
    shown, number = decoded.clone(), torch.arange(len(angles))
    iris = (angles >= 9.0) & (angles < 23.0)
    shown[iris] = BLUE
    shown[iris & (number % 5 == 0)] = BLACK
    shown[iris & (number % 7 == 0)] = 1.0
    shown[angles < 9.0] = 0.9
    white = (angles > 23.0) & (angles < 90.0)
    shown[white] = WHITE * 0.9
    shown[white & (number % 3 == 0)] = BLUE
    return shown


def test_both_eyes_are_found(bare, angles):
    head = bare.head_model
    corners = head.faces[bare.layout.face]
    on_eyes = torch.as_tensor(head.marked("left_eyeball", "right_eyeball")[corners].all(1))
    assert torch.equal(torch.isfinite(angles), on_eyes)
    left = torch.as_tensor(head.marked("left_eyeball")[corners].all(1))
    irises = [int((angles[eye] < 23.0).sum()) for eye in (left, on_eyes & ~left)]
    assert min(irises) > 100
    assert max(irises) < 1.2 * min(irises)


def test_eyes_have_their_color_and_a_dark_pupil(angles, decoded):
    known = torch.ones(len(angles))
    found = plain_eyes(angles, shown_blue(angles, decoded), decoded, known, known)
    for ring, color, off in (((10, 21), BLUE, 0.06), ((26, 80), WHITE * 0.9, 0.06)):
        part = found[(angles > ring[0]) & (angles < ring[1])]
        assert float((part.median(0).values - color).abs().max()) < off
        assert float((part - part.median(0).values).abs().max()) <= 2.0 * DETAIL + 1e-5
    assert float(found[angles < 8.0].max()) < 0.15, "no lamp instead of a pupil"
    assert torch.equal(found[angles.isinf()], decoded[angles.isinf()])


def test_whites_are_never_blue(angles, decoded):
    shown = decoded.clone()
    shown[(angles > 23.0) & (angles < 90.0)] = torch.tensor([0.5, 0.6, 0.9])
    known = torch.ones(len(angles))
    found = plain_eyes(angles, shown, decoded, known, 0.0 * known)[(angles > 26.0) & (angles < 90.0)]
    tint = found / WHITE
    assert float((tint / tint.mean(1, keepdim=True) - 1.0).abs().max()) < 1.5 * WHITE_TINT


def test_eyes_that_no_photo_tells_stay(angles, decoded):
    shown = shown_blue(angles, decoded)
    shut = torch.where(angles.isinf(), 1.0, 0.0)
    assert torch.equal(plain_eyes(angles, shown, decoded, shut, shut), shown)


def test_an_iris_is_no_blot_on_a_lid(bare, decoded):
    share, upper = lash_line(bare)
    line = share > 0.5
    assert min(int((line & upper).sum()), int((line & ~upper).sum())) > 50
    shown, known = decoded.clone(), torch.ones(len(decoded))
    shown[upper & line] = 0.5 * SKIN  # lashes and their shade
    blot = upper & line & (torch.arange(len(line)) % 6 == 0)
    shown[blot] = BLACK  # the iris, above which the lid was when the photo was taken
    shown[line & ~upper] = 0.8 * SKIN
    found = even_lash_line(share, upper, shown, decoded, known)
    whole = share > 0.99
    assert float((found[upper & whole].median(0).values - 0.5 * SKIN).abs().max()) < 0.02, "the dark line stays"
    assert float((found[~upper & whole].median(0).values - 0.8 * SKIN).abs().max()) < 0.02
    assert float(found[blot & whole].mean(1).min()) > 0.9 * LINE[0] * 0.5 * float(SKIN.mean())
    away = share == 0.0
    assert torch.equal(found[away], shown[away])
