"""The face of a head that nobody has painted: every part has a color of its own where the part is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.avatar import load_avatar
from grmm_core.avatar.library import library_path
from grmm_core.controls.names import JOINT_NAMES
from grmm_core.head import load_open_head
from grmm_core.light.materials import materials_of
from grmm_core.light.resting import RestLight, Texels
from grmm_core.model.layout import texel_layout
from grmm_core.model.plain_face import IRIS_DEGREES, PUPIL_DEGREES, accented, plain_face, unlit
from grmm_core.pictures.color import linear_to_srgb, srgb_to_linear
from grmm_core.pictures.images import quantize

PIXELS = 256


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def texels(head, picture):
    """The layout of a picture and the display color of each texel, [N, 3]."""
    layout = texel_layout(head.uv, head.uv_faces, len(picture))
    colors = picture.reshape(-1, 3)[layout.texel] / 255.0
    return layout, colors


def test_parts_of_the_face_have_colors_of_their_own(head):
    picture = plain_face(head, PIXELS)
    assert picture.shape == (PIXELS, PIXELS, 3)
    assert picture.dtype == np.uint8
    layout, colors = texels(head, picture)
    inside = {name: head.marked(name)[head.faces[layout.face]].all(1) for name in head.regions}
    other = inside["lips"] | inside["brows"] | inside["lids"]
    skin = np.median(colors[inside["face"] & ~other], 0)
    middle = {name: np.median(colors[inside[name]], 0) for name in ("lips", "brows", "scalp", "upper_teeth")}
    assert middle["lips"][0] / middle["lips"][1] > 1.15 * skin[0] / skin[1]
    assert middle["brows"].sum() < 0.6 * skin.sum()
    assert middle["scalp"].sum() < 0.4 * skin.sum()
    assert middle["upper_teeth"].sum() > skin.sum()
    points = (head.v_template[head.faces[layout.face]] * layout.barycentric[..., None]).sum(1)
    ways = points - head.joints(np.zeros(head.shape_count, np.float32))[JOINT_NAMES.index("left_eye")]
    angle = np.degrees(np.arccos(ways[:, 2] / np.linalg.norm(ways, axis=1)))
    ball = inside["left_eyeball"]
    pupil, iris = colors[ball & (angle < PUPIL_DEGREES - 2)], colors[ball & (angle > 12) & (angle < IRIS_DEGREES - 5)]
    white = colors[ball & (angle > IRIS_DEGREES + 3)]
    assert pupil.max() < 0.2 < iris[:, 0].min()
    assert iris.max() < 0.5 < white.min()


def test_a_head_without_regions_is_skin(head):
    bare = replace(head, regions={name: head.regions[name] for name in ("left_eyeball", "right_eyeball")})
    layout, colors = texels(bare, plain_face(bare, 64))
    skin = ~bare.marked("left_eyeball", "right_eyeball")[bare.faces[layout.face]].any(1)
    assert np.ptp(colors[skin], axis=0).max() == 0


def test_a_painting_is_accented_where_a_bare_mesh_wants_it_plainer(head):
    painting = load_avatar(library_path("default")).painting
    layout, before = texels(head, painting)
    after = texels(head, accented(head, painting))[1]
    inside = {name: head.marked(name)[head.faces[layout.face]].all(1) for name in head.regions}
    ball = inside["left_eyeball"]
    centre = head.joints(np.zeros(head.shape_count, np.float32))[JOINT_NAMES.index("left_eye")]
    points = (head.v_template[head.faces[layout.face]] * layout.barycentric[..., None]).sum(1) - centre
    angle = np.degrees(np.arccos(points[:, 2] / np.linalg.norm(points, axis=1)))
    pupil = ball & (angle < PUPIL_DEGREES - 2)
    assert after[pupil].max() < 0.1 < before[pupil].max()
    darkest = [np.quantile(colors[inside["brows"]], 0.05) for colors in (before, after)]
    assert darkest[1] < darkest[0] - 0.05
    tone = np.median(before[inside["face"]], 0)
    assert np.abs(after[inside["ears"]] - tone).mean() < 0.5 * np.abs(before[inside["ears"]] - tone).mean()  # hair hid them
    places = points + centre
    neck = inside["neck"] & (places[:, 2] > 0.0)
    hung = np.abs(before[neck] - tone).max(1) > 0.3
    assert hung.mean() > 0.1
    assert (np.abs(after[neck] - tone).max(1) > 0.3).mean() < 0.01
    apart = head.marked("brows", "ears", "neck", "left_eyeball", "right_eyeball")[head.faces[layout.face]].any(1)
    front = inside["face"] & ~apart & (np.abs(places[:, 0]) < 0.02) & (places[:, 1] > -0.04)
    np.testing.assert_allclose(after[front | inside["scalp"]], before[front | inside["scalp"]], atol=1e-6)


def test_a_gray_head_painted_in_the_studios_light_is_gray_again_without_it(head):
    """What the jaw shades, too: it stayed in the colors, and a scene shaded necks twice."""
    layout = texel_layout(head.uv, head.uv_faces, PIXELS)
    points, gray = Texels.of(head, layout.face, layout.barycentric), np.full((len(layout.face), 3), 0.58)
    light = RestLight.of(head, points, materials_of(head, *points[:2]), head.v_template.astype(float), gray).rig.mean(1)
    painting = np.zeros((PIXELS * PIXELS, 3), np.uint8)
    painting[layout.texel] = quantize(linear_to_srgb(0.3 * light / np.pi))[:, None]
    again = unlit(head, head.v_template, painting.reshape(PIXELS, PIXELS, 3))
    bare = head.marked("face", "neck") & ~head.marked("lips", "lids", "mouth_interior", "brows", "lashes")
    skin = bare[head.faces[layout.face]].all(1)
    before, after = (srgb_to_linear(texels(head, one.reshape(PIXELS, PIXELS, 3))[1][skin, 0]) for one in (painting, again))
    uneven, left = (np.ptp(np.quantile(values, (0.05, 0.95))) for values in (before, after))
    assert uneven > 0.2
    assert left < 0.1 * uneven
    assert np.median(after) == pytest.approx(0.3, abs=0.01)
