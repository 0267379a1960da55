"""Light taken out of skin colors, and gradients of relit colors against finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from grmm_core.controls.names import EXPRESSION_NAMES
from grmm_core.errors import ShapeError
from grmm_core.fitting.person_lights import doubts, mean_flat
from grmm_core.fitting.photo_light import MATT, SUNS, Light, PhotoHead, Seen, Shown, seen_skin
from grmm_core.fitting.result import photo_light
from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head
from grmm_core.light.materials import materials_of
from grmm_core.light.relight import relit, to_display, to_linear, unlit
from grmm_core.light.resting import MOUTH, RestLight, Texels, casters_of
from grmm_core.light.shading import Transport, transport
from grmm_core.light.shadows import visible
from grmm_core.light.turning import turned_light

SKIN = np.array([0.5, 0.3, 0.22])


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def texels(head):
    """Some points of skin."""
    faces = np.flatnonzero(head.marked("face", "neck")[head.faces].all(1))[::3].astype(np.int32)
    return Texels.of(head, faces, np.full((len(faces), 3), 1.0 / 3.0, np.float32))


@pytest.fixture(scope="module")
def photo_head(head, texels):
    rest = head.v_template.astype(float)
    return PhotoHead(head, texels, Shown(rest, rest), np.array([0.0, 0.0, 1.0]), np.asarray(to_display(SKIN)))


@pytest.fixture(scope="module")
def side():
    """A colored light from a side, and a dim one from everywhere."""
    suns, around = np.zeros((len(SUNS), 3), np.float32), np.zeros((9, 3), np.float32)
    suns[np.argmax([sun.direction[0] for sun in SUNS])] = [4.0, 3.0, 2.0]
    around[0] = 0.8
    return Light(suns, around, SKIN, np.ones(3))


@pytest.fixture(scope="module")
def shade(photo_head):
    """Skin of one tone in the studio's rig, as trained colors have it, [N, 3]."""
    rig = photo_head._rest.rig.clip(1e-3)
    return rig / np.median(rig, 0)


def test_a_turned_head_in_the_studio_is_taken_for_one(head, texels, shade):
    """The rig stays while the neck turns the head, which is no other light."""
    pose = np.zeros((5, 3), np.float32)
    pose[1] = np.radians([10.0, 25.0, 0.0])
    rest, posed = head.v_template.astype(float), head.vertices(np.zeros(1), np.zeros(1), pose).astype(float)
    turned = turned_light(head, texels, posed, pose)
    place = np.array([0.0, 0.0, 1.0]), np.asarray(to_display(SKIN))
    seen = Seen(np.asarray(to_display(SKIN * shade * turned)), np.ones(len(shade)))
    assert not PhotoHead(head, texels, Shown(rest, posed), *place, turned).solve(seen).known


def test_skin_lit_from_a_side_becomes_even_and_its_own_light_makes_it_as_before(photo_head, side, shade):
    random = np.random.default_rng(0)
    lit = photo_head.ratio(side)
    marks = np.where(random.random(len(lit)) < 0.05, 0.6, 1.0)[:, None]  # freckles stay
    colors = to_display(SKIN * marks * lit * shade)
    found = photo_head.solve(Seen(colors, np.ones(len(lit))))
    ratio = photo_head.ratio(found)
    flat = unlit(colors, ratio)
    told = (lit > 0.25).all(1) & photo_head.told
    plain, freckled = ((to_linear(flat) / shade)[told & (marks[:, 0] == value)] for value in (1.0, 0.6))
    uneven, left = (values.std(0) / values.mean(0) for values in (lit[told], plain))
    assert uneven.min() > 0.35
    assert (left < 0.4 * uneven).all()
    np.testing.assert_allclose(freckled.mean(0) / plain.mean(0), 0.6, atol=0.08)
    again = relit(flat[None], np.ones((1, len(flat))), ratio[None], np.zeros((1, len(flat), 3)))[0]
    assert math.sqrt(((again - colors)[told] ** 2).mean()) < 0.005
    assert found.suns.min() >= 0.0
    assert len(found.lighting.lamps) <= len(SUNS)


def test_the_lit_side_of_a_face_half_in_shade_tells_its_tone(photo_head, side, shade):
    """As photos beside a window are exposed, whichever side there is more of."""
    hard = side._replace(around=0.1 * side.around)
    lit = photo_head.ratio(hard)
    strength = lit.mean(1)
    bright = (strength > 0.5 * np.quantile(strength, 0.9)) & photo_head.told
    weights = np.where(bright & (np.arange(len(lit)) % 3 > 0), 0.0, 1.0)  # more is seen of the shade
    assert (strength[(weights > 0) & photo_head.told] < 0.5 * strength[bright].min()).mean() > 0.5
    seen = Seen(np.asarray(to_display(SKIN * lit / np.median(lit[bright], 0) * shade)), weights)
    found = photo_head.solve(seen)
    flat = np.median((to_linear(seen.colors) / photo_head.ratio(found) / shade)[bright], 0)
    np.testing.assert_allclose(flat, SKIN, rtol=0.35)  # a twentieth of it by the median of all that is seen
    assert (found.tone > 0.3 * SKIN).all()


def test_skin_that_tells_no_light_is_in_the_studios(photo_head):
    seen = Seen(np.full((len(photo_head.told), 3), 0.5), (~photo_head.told).astype(float))
    assert (seen.weights > 0).any()
    light = photo_head.solve(seen)
    assert not light.known
    np.testing.assert_allclose(light.tone, to_linear(np.full(3, 0.5)), rtol=1e-5)
    np.testing.assert_array_equal(photo_head.lit(seen, photo_head.ratio(light)), seen.weights > 0)


def test_light_of_a_second_photo_is_found_for_the_tone_of_the_first(photo_head, side, shade):
    dimmed = side._replace(suns=0.5 * side.suns, around=0.5 * side.around)
    colors = to_display(SKIN * photo_head.ratio(dimmed) * shade)
    found = photo_head.ratio(photo_head.solve(Seen(colors, np.ones(len(colors))), SKIN))
    np.testing.assert_allclose(found.mean(0), photo_head.ratio(dimmed).mean(0), rtol=0.08)


def test_several_photos_tell_marks_from_light(photo_head, side, shade):
    """A face whose one half is darker than the other; a second photo shows that half only."""
    places = photo_head._rest.vertices[photo_head._texels.corners].mean(1)
    dark = places[:, 0] < 0.0
    color = SKIN * np.where(dark, 0.7, 1.0)[:, None] * shade
    even = side._replace(suns=0.0 * side.suns + 0.3, around=1.5 * side.around)
    seen = [
        Seen(to_display(color * photo_head.ratio(light)), weights)
        for light, weights in ((even, np.ones(len(dark))), (side, dark.astype(float)))
    ]
    first = photo_head.solve(seen[0])
    alone = found = [first, photo_head.solve(seen[1], first.tone)]
    for _ in range(2):
        every, ratios = [(one, photo_head) for one in seen], [photo_head.spread(light) for light in found]
        flat = mean_flat(every, ratios, doubts(every, ratios))
        found = [photo_head.again(one, light, flat) for one, light in zip(seen, found, strict=True)]

    def apart(lights):
        one, two = (to_linear(s.colors) / photo_head.ratio(light) for s, light in zip(seen, lights, strict=True))
        return float(np.abs(np.log(one / two))[photo_head.told & dark].mean())

    assert apart(found) < 0.6 * apart(alone)


def test_a_photo_whose_light_leaves_the_skin_uneven_hardly_counts(photo_head, side, shade):
    """Of a light that no sum of wide ones explains, what is left is no color."""
    random = np.random.default_rng(0)
    even = side._replace(suns=0.0 * side.suns + 0.3)
    blotched = np.exp(0.6 * np.sin(200.0 * photo_head._rest.vertices[photo_head._texels.corners].mean(1)[:, 1:2]))
    every = [
        (Seen(to_display(SKIN * shade * photo_head.ratio(light) * apart), np.ones(len(shade))), photo_head)
        for light, apart in ((even, random.normal(1.0, 0.03, (len(shade), 1))), (side, blotched))
    ]
    ratios = [photo_head.spread(light) for light in (even, side)]
    doubt = doubts(every, ratios)
    assert doubt[1] > 3.0 * doubt[0]
    told = photo_head.told
    off, alike = (np.log(mean_flat(every, ratios, d) / (SKIN * shade))[told].std() for d in (doubt, np.ones(2)))
    assert off < 0.05 < alike


def test_a_photo_hardly_counts_whose_light_misses_a_lamp_at_the_side(photo_head, side, shade):
    """It shines on a third of the skin, and the median of the rest looks well."""
    even = side._replace(suns=0.0 * side.suns + 0.3)
    across = photo_head._rest.vertices[photo_head._texels.corners].mean(1)[:, 0]
    lamp = np.where(across > np.percentile(across[photo_head.told], 67), 2.5, 1.0)[:, None]
    random = np.random.default_rng(0).normal(1.0, 0.05, (len(shade), 1))
    every = [
        (Seen(to_display(0.4 * SKIN * shade * photo_head.ratio(even) * more), np.ones(len(shade))), photo_head)
        for more in (random, random * lamp)
    ]
    doubt = doubts(every, [photo_head.spread(even)] * 2)
    assert doubt[1] > 3.0 * doubt[0]


def test_the_studios_light_is_as_strong_as_photos_of_either_side_agree(photo_head, shade):
    """Each photo's own median would make one side as bright as the other."""
    places = photo_head._rest.vertices[photo_head._texels.corners].mean(1)
    color = SKIN * np.where(places[:, 0] < 0.0, 0.7, 1.0)[:, None] * shade
    weights = np.clip(0.5 + np.array([[1.0], [-1.0]]) * places[:, 0] / 0.03, 0.0, 1.0)
    every = [(Seen(to_display(color), one), photo_head) for one in weights]
    first = photo_head.solve(every[0][0])
    second = first._replace(level=np.full(3, 0.7, np.float32))
    assert not second.known
    flat = mean_flat(every[:1], [photo_head.spread(first)], np.ones(1))
    found = photo_head.exposed(every[1][0], second, flat, weights[0] > 0.3)
    np.testing.assert_allclose(found.level, 1.0, atol=0.12)


def test_colors_of_the_studio_stay_as_they_are(photo_head, shade):
    colors = to_display(0.3 * shade)
    found = photo_head.solve(Seen(colors, np.ones(len(colors))))
    assert not found.known
    np.testing.assert_allclose(found.level, 1.0)
    dimmer = photo_head.solve(Seen(to_display(0.15 * shade), np.ones(len(colors))), found.tone)
    np.testing.assert_allclose(dimmer.level, 0.5, rtol=1e-3)


def test_skin_is_seen_where_it_faces_the_camera_and_belongs_to_the_person(head, texels):
    camera = Camera.orbit(64, 64, yaw=0.0)
    picture = np.zeros((64, 64, 3))
    picture[:, 32:] = 1.0
    inside = np.ones((64, 64))
    inside[:16] = 0.0
    seen = seen_skin(head, texels, head.v_template, camera, picture, inside)
    points = texels.at(head.v_template)
    rows = camera.project(points.astype(float))[1][:, 1]
    shown = seen.weights > 0
    assert shown.sum() > 100
    assert not shown[rows < 15].any()
    assert seen.colors[shown & (points[:, 0] > 0.02)].min() > 0.9  # her left is at the right
    back = seen_skin(head, texels, head.v_template, Camera.orbit(64, 64, yaw=180.0), picture, np.ones((64, 64)))
    face = head.marked("face")[texels.corners].all(1)
    assert (back.weights[face & (points[:, 2] > 0.07)] == 0.0).all()


def test_light_that_is_not_known_is_the_studios(avatar_of_before):
    assert photo_light(avatar_of_before).lighting is None
    with pytest.raises(ShapeError, match="photo 2"):
        photo_light(avatar_of_before, 1)


@pytest.fixture
def avatar_of_before():
    """What a fit of an earlier version knows of its photo."""
    from types import SimpleNamespace

    return SimpleNamespace(name="before", tracking={"pose": np.zeros((1, 5, 3)), "light": np.zeros((1, 9, 3))})


def test_teeth_are_not_dark_in_the_rig_although_the_mouth_is_closed_at_rest(head):
    faces = np.flatnonzero(head.marked("upper_teeth", "lower_teeth")[head.faces].all(1)).astype(np.int32)[::5]
    more = np.flatnonzero(head.marked("face")[head.faces].all(1)).astype(np.int32)[::20]
    texels = Texels.of(head, np.concatenate([faces, more]), np.full((len(faces) + len(more), 3), 1.0 / 3.0, np.float32))
    colors = np.full((len(texels.face), 3), 0.6)
    rest = RestLight.of(head, texels, materials_of(head, *texels[:2]), head.v_template.astype(float), colors)
    front = np.median(rest.rig[: len(faces)][rest.rig[: len(faces), 0] > 0.1 * rest.rig.max()], 0)
    assert 0.1 < float(front.mean() / np.median(rest.rig[len(faces) :], 0).mean()) < 0.6


def test_a_mouth_has_one_light_without_color_or_edges(head, side):
    wide = head.arkit_to_expression[list(EXPRESSION_NAMES[:52]).index("jawOpen")]
    rest, posed = head.v_template.astype(float), head.vertices(np.zeros(1), wide, np.zeros((5, 3)))
    faces = np.arange(0, len(head.faces), 3, dtype=np.int32)
    texels = Texels.of(head, faces, np.full((len(faces), 3), 1.0 / 3.0, np.float32))
    eye, skin = np.array([0.0, 0.0, 1.0]), np.asarray(to_display(SKIN))
    found = PhotoHead(head, texels, Shown(rest, posed), eye, skin).ratio(side)
    inside, lips = (head.marked(*names)[texels.corners].all(1) for names in (MOUTH, ("lips",)))
    assert inside.sum() > 100
    assert np.ptp(found[inside]) < 1e-4 * found[inside].max()
    assert 1.0 < found[inside].mean() / np.median(found[lips].mean(1)) < 1.5
    assert np.ptp(found[lips & ~inside], axis=0).min() > 0.2  # beside it light has color and shape


def test_relit_colors_have_the_gradients_of_finite_differences(head, texels):
    random = np.random.default_rng(0)
    rest = head.v_template.astype(float)
    materials = materials_of(head, *texels[:2])
    still = RestLight.of(head, texels, materials, rest, np.full((len(texels.face), 3), 0.6))
    receivers, casters = texels.receivers(rest, still.normals), casters_of(head, rest)
    seen = [visible(sun, receivers, casters) for sun in SUNS]
    parts = transport(SUNS, receivers, seen, materials, still.transfer, np.array([0.0, 0.0, 1.0]), MATT)
    rows = random.choice(np.flatnonzero((still.rig > 0.3 * still.rig.max()).all(1)), 12, replace=False)
    chosen = (a[:, rows] if len(a) == len(SUNS) else a[rows] for a in vars(parts).values())
    some = Transport(*(torch.from_numpy(np.float64(array)) for array in chosen))
    rig, alpha = torch.from_numpy(np.float64(still.rig[rows])), torch.ones(3, 4, dtype=torch.float64)

    def lit(flat, lamps, around):
        irradiance, highlights = some.light(lamps, around)
        return relit(flat, alpha, (irradiance / rig).reshape(3, 4, 3), highlights.reshape(3, 4, 3))

    given = [random.uniform(0.2, 0.7, (3, 4, 3)), random.uniform(0.1, 1.0, (len(SUNS), 3)), random.uniform(0.05, 0.3, (9, 3))]
    assert torch.autograd.gradcheck(lit, [torch.from_numpy(array).requires_grad_() for array in given], eps=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "shape"), [("suns", (1, 3, 3)), ("around", (1, 2)), ("tone", ()), ("level", None), ("local", ()), ("fine", ())]
)
def test_a_damaged_light_in_a_file_is_refused_in_one_sentence(avatar_of_before, name, shape):
    tables = avatar_of_before.tracking
    tables |= {f"light_{key}": table[None] for key, table in Light.studio()._asdict().items() if key not in ("local", "fine")}
    assert photo_light(avatar_of_before).lighting is None
    if shape is None:
        del tables[f"light_{name}"]
    else:
        tables[f"light_{name}"] = np.ones(shape, np.float32)
    with pytest.raises(ShapeError, match=r"make (it|the avatar) from photos again\.$"):
        photo_light(avatar_of_before)
