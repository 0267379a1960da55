"""What lids leave of the light on eyes."""

from __future__ import annotations

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.head import load_open_head
from grmm_core.light.cornea import EYEBALLS
from grmm_core.light.eye_shade import IRIS, UPPER, WHITE, eyes_of, polar_angles
from grmm_core.light.resting import Texels


def texels_of(head):
    """Texels at the middles of a head's faces."""
    count = len(head.faces)
    return Texels.of(head, np.arange(count), np.full((count, 3), 1.0 / 3.0, np.float32))


def posed(head, **controls):
    """The mean head in an expression."""
    expression = sum((head.arkit_to_expression[ARKIT_NAMES.index(k)] * v for k, v in controls.items()), np.zeros(1))
    return head.vertices(np.zeros(1), expression, np.zeros((5, 3)))


def test_whites_are_darker_than_they_were_learned_and_darkest_below_the_upper_lid():
    head = load_open_head()
    texels, vertices = texels_of(head), posed(head)
    shade = eyes_of(head, texels).shade(vertices)
    ball = head.marked(*EYEBALLS)[texels.corners].all(1)
    np.testing.assert_array_equal(shade[~ball], 1.0)
    light = shade.astype(float) ** 2.2
    angles, height = polar_angles(head, texels), vertices[texels.corners].mean(1)[:, 1]
    whites = (angles > 26.0) & (angles < 36.0)
    assert (light[whites] <= WHITE + 1e-6).all()
    assert light[whites, 1].max() > 0.7 * WHITE[1]
    highest = whites & (height > np.quantile(height[whites], 0.9))  # behind the upper lid
    np.testing.assert_allclose(light[highest], (1.0 - UPPER[0]) * WHITE[None].repeat(highest.sum(), 0), rtol=0.05)
    iris = polar_angles(head, texels) < 20.0
    assert (light[iris] <= IRIS + 1e-6).all()
    assert (light[iris] > WHITE.min() * 0.5).all()


def test_the_shade_comes_and_goes_with_the_lid():
    """A lid that falls darkens the eye below it, a lifted one brightens it; texels of the skin are never touched."""
    head = load_open_head()
    texels = texels_of(head)
    at_rest, falling, wide = (
        eyes_of(head, texels).shade(posed(head, **{f"{kind}Left": amount, f"{kind}Right": amount}))
        for kind, amount in (("eyeBlink", 0.0), ("eyeBlink", 0.4), ("eyeWide", 1.0))
    )
    pupils = polar_angles(head, texels) < 10.0
    assert falling[pupils].mean() < at_rest[pupils].mean() - 0.05
    assert wide[pupils].mean() > at_rest[pupils].mean() + 0.01
    one = eyes_of(head, texels).shade(posed(head, eyeBlinkLeft=0.4))
    left = head.marked("left_eyeball")[texels.corners].all(1)
    np.testing.assert_allclose(one[left], falling[left], atol=1e-6)
    np.testing.assert_allclose(one[~left], at_rest[~left], atol=1e-6)


def test_it_turns_along_with_the_head():
    head = load_open_head()
    texels, pose = texels_of(head), np.zeros((5, 3))
    pose[0] = 0.3, 0.8, -0.2
    pose[1] = 0.2, -0.3, 0.1
    turned = eyes_of(head, texels).shade(head.vertices(np.zeros(1), np.zeros(1), pose))
    np.testing.assert_allclose(turned, eyes_of(head, texels).shade(posed(head)), atol=2e-3)


def test_heads_without_lashes_have_none():
    head = load_open_head()
    regions = {name: rows for name, rows in head.regions.items() if name != "lashes"}
    bare = type(head)(**{**{f: getattr(head, f) for f in head.__dataclass_fields__}, "regions": regions})
    assert eyes_of(bare, texels_of(bare)) is None
