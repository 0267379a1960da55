"""What colors that were learned lack: dark mouths, the tone of lips."""

from __future__ import annotations

import numpy as np

from grmm_core.head import load_open_head
from grmm_core.light.lip_tone import LOWER, UPPER, lip_tone, tone_at
from grmm_core.light.mouth_shade import LEFT, THIN, depth_leaves
from grmm_core.light.resting import Texels
from grmm_core.light.tones import Tones


def texels_of(head):
    """Texels at the middles of a head's faces."""
    count = len(head.faces)
    return Texels.of(head, np.arange(count), np.full((count, 3), 1.0 / 3.0, np.float32))


def without(head, *regions):
    """A head that lacks some regions."""
    left = {name: rows for name, rows in head.regions.items() if name not in regions}
    return type(head)(**{**{f: getattr(head, f) for f in head.__dataclass_fields__}, "regions": left})


def test_mouths_get_darker_the_deeper_they_are_and_nothing_else_does():
    head = load_open_head()
    leaves = depth_leaves(head)
    inside = head.marked("mouth_interior", "tongue") & ~head.marked("lips")
    np.testing.assert_array_equal(leaves[~inside], 1.0)
    tongue = np.asarray(head.regions["tongue"])
    by_depth = leaves[tongue[np.argsort(-head.v_template[tongue, 2])]]
    assert by_depth[:10].mean() > by_depth[len(by_depth) // 2] + 0.1
    assert abs(leaves.min() - LEFT) < 0.01
    skin = head.v_template[head.marked("face", "neck") & ~head.marked("mouth_interior")]
    cheeks = [row for row in np.flatnonzero(inside) if np.linalg.norm(skin - head.v_template[row], axis=1).min() < 0.9 * THIN]
    assert len(cheeks) > 30
    np.testing.assert_array_equal(leaves[cheeks], 1.0)  # what shines through cheeks stays as it was learned


def test_lips_take_their_tones_and_the_skin_beside_them_none():
    head = load_open_head()
    marks = head.landmark_positions(head.v_template, 478).astype(float)
    upper, lower = (0.5 * (marks[[edge]] + marks[[middle]]) for edge, middle in ((0, 13), (17, 14)))
    np.testing.assert_allclose(tone_at(head, upper)[0], UPPER, atol=0.02)
    np.testing.assert_allclose(tone_at(head, lower)[0], LOWER, atol=0.02)
    beside = marks[[0, 17]] + [[0.0, 0.002, 0.0], [0.0, -0.002, 0.0]]
    np.testing.assert_allclose(tone_at(head, beside), 1.0, atol=1e-6)
    corners = tone_at(head, marks[[61, 291]])
    np.testing.assert_allclose(corners[0], corners[1], atol=0.05)
    assert corners.max() < 0.5, "a dark crease"
    aside = marks[[61, 61, 61]] + [[-0.009, 0.0, 0.0], [0.0, 0.004, 0.0], [0.0, -0.004, 0.0]]
    assert tone_at(head, aside).min() > 0.95
    texels = texels_of(head)
    tone = lip_tone(head, texels)
    others = head.marked("upper_teeth", "lower_teeth", "tongue", "left_eyeball", "right_eyeball", "scalp", "ears")
    np.testing.assert_array_equal(tone[others[texels.corners].any(1)], 1.0)


def test_all_of_it_is_one_factor():
    head = load_open_head()
    texels, rest = texels_of(head), head.v_template
    both, eyes, mouth = (Tones.of(head, texels, *which) for which in ((True, True), (True, False), (False, True)))
    np.testing.assert_allclose(both.shade(rest), eyes.shade(rest) * mouth.shade(rest))
    assert Tones.of(head, texels, False, False).shade(rest) is None
    lips = Tones.of(without(head, "mouth_interior"), texels, False).steady
    np.testing.assert_array_equal(lips, lip_tone(without(head, "mouth_interior"), texels))
