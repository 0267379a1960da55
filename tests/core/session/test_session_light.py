"""Avatars in the light of a scene, for both engines, in this process and in a worker."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from grmm_core.controls.frame import Controls
from grmm_core.errors import ShapeError
from grmm_core.fitting.photo_light import MATT
from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head
from grmm_core.light.lamps import STUDIO, Lighting, Point, Spot, Sun, soft_box
from grmm_core.light.resting import MOUTH
from grmm_core.light.shading import LEAST_FRONT, Response
from grmm_core.light.surroundings import Surroundings
from grmm_core.pictures.color import linear_to_srgb
from grmm_core.session import HairUse, Instance, RenderOptions, create_session, wardrobe
from grmm_core.session.lit import RATIO, SHADOW, LitAvatar
from grmm_core.session.wardrobe import Wardrobe

CAMERA = Camera.orbit(128, 128, 10, fov=20)
PASSES = ("rgb", "alpha", "hair", "linear", "diffuse", "specular", "shadow")
BALD = HairUse("none", brows="none", beard="none", lashes="none")  # what strands do with light has tests of its own
LEFT = Lighting((Sun(direction=(1.0, 0.0, 0.0), strength=3.0),))


@pytest.fixture(scope="module", params=["torch", "plain"])
def session(request):
    with create_session("local", engine=request.param) as session:
        yield session


def drawn(session, lighting, response=Response(), controls=Controls(), hair=BALD, matrix=None, camera=CAMERA):  # noqa: B008
    placed = Instance(
        session.open("default").id, controls, np.eye(4) if matrix is None else matrix, hair=hair or HairUse(), response=response
    )
    return session.render([placed], camera, RenderOptions(passes=PASSES, lighting=lighting))


def halves(picture):
    """Mean of the person's left (the picture's right) and right half."""
    middle = picture.shape[1] // 2
    return float(picture[:, middle:].mean()), float(picture[:, :middle].mean())


def test_unlit_avatars_are_drawn_as_ever(session):
    plain = session.render([Instance(session.open("default").id, hair=BALD)], CAMERA, RenderOptions(passes=PASSES))
    same = drawn(session, LEFT, response=None)
    for name in ("rgb", "alpha", "linear"):
        np.testing.assert_array_equal(same[name], plain[name])
    np.testing.assert_allclose(plain["diffuse"], plain["linear"][..., :3], atol=1e-4)
    assert not plain["specular"].any()


@pytest.mark.parametrize("turns", [{"neck.y": 0.35}, {"neck.x": 0.25}, {"neck.y": -0.3, "neck.x": -0.2}])
def test_the_studios_light_stays_when_the_neck_turns_a_head(session, turns):
    """An unlit avatar is drawn as one that the rig lights, but for shadows; so is the picture that other light replaces."""
    controls, matt = Controls().set_named(turns), Response(gloss=0.0)
    unlit, lit = (drawn(session, lighting, matt, controls) for lighting in (None, STUDIO))
    straight = drawn(session, None, matt)
    covered = lit["alpha"][..., 0] > 0.9
    assert np.abs(unlit["rgb"] - lit["rgb"])[covered].mean() < 0.02  # 0.022 to 0.036 where the light turned with the head
    assert abs(unlit["rgb"][covered].mean() - straight["rgb"][straight["alpha"][..., 0] > 0.9].mean()) < 0.1


@pytest.mark.parametrize("size", [0.1, 20.0])
def test_light_on_a_scaled_head_is_that_on_the_head(session, size):
    """Light was read from the mesh by world metres: blurred on large heads, and on what hides the mesh of small ones."""
    lamp = Point(strength=20.0, position=(0.8, 0.3, 0.8), radius=0.05)
    scaled = Point(strength=20.0 * size**2, position=tuple(size * x for x in lamp.position), radius=0.05 * size)
    matrix, placed = np.diag([size, size, size, 1.0]), CAMERA.world_to_camera.copy()
    placed[:3, 3] *= size
    large = drawn(session, Lighting((scaled,)), hair=None, matrix=matrix, camera=replace(CAMERA, world_to_camera=placed))
    plain = drawn(session, Lighting((lamp,)), hair=None)
    off = np.abs(large["rgb"] - plain["rgb"])
    assert off.mean() < 1e-4
    assert np.quantile(off, 0.999) < 0.01


def test_in_the_studios_rig_a_lit_avatar_looks_as_it_was_learned(session):
    plain = drawn(session, None)["rgb"]
    lit = drawn(session, STUDIO)
    covered = lit["alpha"][..., 0] > 0.9
    assert np.abs(lit["rgb"] - plain)[covered].mean() < 0.02


def test_in_the_studios_rig_nothing_is_changed_at_rest(session):
    target = session.target(session.open("default").id)
    inputs = session.evaluator.inputs(target, Controls())
    with session.engine.calling():
        lit = LitAvatar(session.evaluator, target, inputs, STUDIO, Response())
        (light,) = lit.channels(np.array([0.0, 0.0, 1.1]), None)
    head = target.model.head_model  # what lips hide at rest has colors of other expressions
    skin = (head.marked("face") & ~head.marked("lips"))[head.faces[target.model.layout.face]].all(1)
    # a bright texel counts twice: shadows are not looked for on what is turned away
    skin &= light[:, SHADOW.start - 1] > 2.0 * LEAST_FRONT
    assert skin.sum() > 5000
    ratio = light[skin, RATIO] / light[skin, SHADOW.start - 1 : SHADOW.start]
    assert np.quantile(np.abs(ratio - 1.0), 0.99) < 1e-3


@pytest.mark.parametrize("names", [("eyeBlink",), ("browOuterUp",), ("mouthSmile", "cheekSquint")])
def test_in_the_studios_rig_light_of_an_expression_is_not_counted_twice(session, names, monkeypatch):
    """Colors brighten where lids shut: the rig that is taken off does as well, or they would be white."""
    controls = Controls().set_named({f"{name}{side}": 1.0 for name in names for side in ("Left", "Right")})
    learned = drawn(session, None, response=None, controls=controls)["rgb"]

    def error():
        return np.quantile(np.abs(drawn(session, STUDIO, controls=controls)["rgb"] - learned)[20:90], 0.995)

    followed = error()
    monkeypatch.setattr("grmm_core.session.lit.rig_in_colors", lambda rig, *_: rig)
    session.evaluator.cache.clear()
    assert followed < 0.85 * error()
    session.evaluator.cache.clear()


@pytest.mark.parametrize("jaw", [0.3, 0.6])
def test_in_the_studios_rig_an_open_mouth_stays_as_it_was_learned(session, jaw):
    """The inner side of lips burnt out to seven times its light, and teeth had less than a half of theirs."""
    target = session.target(session.open("default").id)
    inputs = session.evaluator.inputs(target, Controls().set_named({"jawOpen": jaw}))
    with session.engine.calling():
        (light,) = LitAvatar(session.evaluator, target, inputs, STUDIO, Response()).channels(np.array([0.0, 0.0, 1.1]), None)
    head, front = target.model.head_model, light[:, SHADOW.start - 1]
    for name in ("lips", *MOUTH):
        shown = head.marked(name)[head.faces[target.model.layout.face]].all(1) & (front > LEAST_FRONT)
        ratio = light[shown, RATIO].mean(1) / front[shown]
        assert shown.sum() > 1000
        assert 0.85 < np.median(ratio) < 1.15
        assert ratio.max() < 1.6


def test_teeth_of_a_grin_get_no_more_light_than_the_lips_around_them(session):
    """Grins bare teeth farther than the pose in which the rig on them is found: in lamps they were white as paper."""
    target = session.target(session.open("default").id)
    names = {"mouthSmile": 0.8, "mouthUpperUp": 0.8, "mouthLowerDown": 0.4}
    grin = Controls().set_named({f"{name}{side}": value for name, value in names.items() for side in ("Left", "Right")})
    for lighting in (STUDIO, Lighting((Sun(direction=(0.0, 0.15, 1.0), strength=3.0),))):
        lit = LitAvatar(session.evaluator, target, session.evaluator.inputs(target, grin), lighting, Response())
        with session.engine.calling():
            (light,) = lit.channels(np.array([0.0, 0.0, 1.1]), None)
        head, front = target.model.head_model, light[:, SHADOW.start - 1]
        ratio = light[:, RATIO].mean(1) / np.maximum(front, 1e-9)
        teeth, lips = (
            head.marked(*names)[head.faces[target.model.layout.face]].all(1) & (front > LEAST_FRONT)
            for names in (("upper_teeth", "lower_teeth"), ("lips",))
        )
        assert ratio[teeth].max() < 1.3 * np.quantile(ratio[lips], 0.75)
        assert ratio[teeth].max() > np.median(ratio[lips]), "they are not dark either"


def test_a_sun_lights_the_side_that_it_stands_on_and_things_throw_shadows(session):
    lit = drawn(session, LEFT)
    bright, dark = halves(lit["linear"][..., :3])
    assert bright > 3 * dark
    wall = np.array([[[0.4, -1.0, -1.0], [0.4, 1.0, -1.0], [0.4, 0.0, 3.0]]])
    assert halves(drawn(session, replace(LEFT, occluders=wall))["linear"][..., :3])[0] < 0.3 * bright
    without = Lighting((replace(LEFT.lamps[0], shadow=False),))
    assert halves(drawn(session, without)["linear"][..., :3])[0] > bright
    shadow = lit["shadow"][..., 0]
    assert halves(shadow)[0] > halves(shadow)[1]


def test_two_lamps_in_one_place_are_one_of_twice_the_power(session):
    """Lamps are looked at side by side: what is known of one is written once, strands' shadow on the skin included."""
    box = soft_box(60, 30, 1.5, 0.5, 30.0)
    twice = drawn(session, Lighting((box, box)), hair=HairUse())["linear"]
    strong = drawn(session, Lighting((replace(box, strength=60.0),)), hair=HairUse())["linear"]
    np.testing.assert_allclose(twice, strong, atol=2e-3)


def test_heads_throw_shadows_on_one_another(session):
    number, aside, afar = session.open("default").id, np.eye(4), np.eye(4)
    aside[0, 3], afar[0, 3] = 0.35, -0.35  # where the sun stands, and on the other side
    options, own = RenderOptions(passes=("linear", "mask"), lighting=LEFT), Instance(number, hair=BALD, response=Response())

    def light(*others):
        instances = [own, *(replace(own, model_to_world=matrix) for matrix in others)]
        return session.render(instances, CAMERA, options)["linear"][..., :3][:, 40:88].mean()  # of the one in the middle

    assert light(aside) < 0.3 * light()
    assert light(afar) == pytest.approx(light(), rel=0.02)
    unlit = session.render([own, replace(own, model_to_world=aside, response=None)], CAMERA, options)["linear"]
    assert unlit[:, 40:88, :3].mean() < 0.3 * light()  # heads in the studio's light are bodies, too


def test_light_of_its_own_is_the_avatars_and_turns_with_it(session):
    number, options = session.open("default").id, RenderOptions(passes=("linear",), lighting=STUDIO)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])

    def own(matrix, camera):
        placed = Instance(number, Controls(), matrix, hair=BALD, response=Response(), lighting=LEFT)
        return session.render([placed], camera, options)["linear"]

    usual = drawn(session, LEFT)["linear"]
    np.testing.assert_allclose(own(np.eye(4), CAMERA), usual, atol=1e-5)  # and the scene's light is not on it
    behind = Camera.orbit(128, 128, 190, fov=20)
    np.testing.assert_allclose(own(turned, behind), usual, atol=2e-3)


def test_light_passes_add_up_to_the_picture(session):
    lit = drawn(session, Lighting((soft_box(30, 20, 1.0, 0.3, 40.0),), Surroundings.even((0.1, 0.1, 0.1))))
    np.testing.assert_allclose(lit["diffuse"] + lit["specular"], lit["linear"][..., :3], atol=2e-3)
    assert lit["specular"].max() > 0.05
    straight = lit["rgb"] / np.maximum(lit["alpha"], 1e-3)
    linear = lit["linear"][..., :3] / np.maximum(lit["alpha"], 1e-3)
    solid = lit["alpha"][..., 0] > 0.99
    np.testing.assert_allclose(straight[solid], linear_to_srgb(linear[solid]), atol=2e-3)


def test_gloss_intensity_and_scattering_do_what_they_say(session):
    light = Lighting((soft_box(60, 20, 1.0, 0.3, 40.0),))
    usual = drawn(session, light)
    assert drawn(session, light, Response(gloss=0.0))["specular"].max() < 0.3 * usual["specular"].max()
    assert drawn(session, light, Response(intensity=0.0))["rgb"].max() < 1e-3
    np.testing.assert_allclose(
        drawn(session, light, Response(intensity=2.0, gloss=0.0))["diffuse"].mean(),
        2 * drawn(session, light, Response(gloss=0.0))["diffuse"].mean(),
        rtol=0.05,
    )
    dark = np.s_[:, :56]  # beyond the edge of the light
    red, _, blue = drawn(session, light, Response(scattering=3.0))["diffuse"][dark].mean((0, 1)) / usual["diffuse"][dark].mean(
        (0, 1)
    )
    assert red > 1.05 * blue


def test_detail_is_in_highlights_alone_and_none_from_afar(session):
    light = Lighting((soft_box(45, 30, 1.0, 0.05, 30.0),))
    close = Camera.orbit(128, 128, 20, 5, fov=4, target=(0.03, 0.06, 0.08))
    fine, usual, smooth = (drawn(session, light, Response(detail=value), camera=close) for value in (2.0, 1.0, 0.0))
    np.testing.assert_allclose(usual["diffuse"], smooth["diffuse"], atol=1e-3)
    changed = [np.abs(one["specular"] - smooth["specular"]).mean() for one in (usual, fine)]
    assert changed[1] > 1.2 * changed[0] > 0.02 * smooth["specular"].mean()
    assert usual["specular"].mean() == pytest.approx(smooth["specular"].mean(), rel=0.1)
    far = Camera.orbit(64, 64, 20, 5, fov=40)
    one, other = (drawn(session, light, Response(detail=value), camera=far)["rgb"] for value in (1.0, 0.0))
    assert np.abs(one - other).max() < 4e-3


def test_coarser_levels_are_lit_alike(session):
    """Blocks of texels have the light of their middle."""
    placed = Instance(session.open("default").id, response=Response())
    fine, coarse = (
        session.render([placed], CAMERA, RenderOptions(passes=("linear",), lighting=LEFT, lod=lod))["linear"] for lod in (0, 1)
    )
    assert np.abs(fine - coarse).mean() < 0.02
    assert halves(coarse[..., :3])[0] > 3 * halves(coarse[..., :3])[1]


def test_light_belongs_to_the_world_and_not_to_the_head(session):
    turn = np.eye(4)
    turn[:3, :3] = [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]  # looks to where its right was
    camera = CAMERA.transformed(np.linalg.inv(turn))  # moves along: the same picture, but for the light
    ahead = drawn(session, LEFT, matrix=turn, camera=camera)["rgb"]
    turned = Lighting((Sun(direction=tuple(turn[:3, :3].T @ [1.0, 0.0, 0.0]), strength=3.0),))
    np.testing.assert_allclose(ahead, drawn(session, turned)["rgb"], atol=5e-3)


@pytest.mark.parametrize(
    ("lamp", "most"),
    [
        (lambda turn: Sun(direction=(math.sin(turn), 0.3, math.cos(turn)), strength=3.0), 1.0),
        (lambda turn: soft_box(math.degrees(turn), 20.0, 1.5, 0.4, 40.0), 0.6),
    ],
    ids=["sun", "soft box"],
)
def test_a_slow_turn_of_a_lamp_does_not_flicker(session, lamp, most):
    """What changes from step to step changes little by itself: second differences are small against first ones."""
    frames = [drawn(session, Lighting((lamp(turn),)))["rgb"] for turn in np.radians(np.arange(30.0, 91.0))]
    steps = [b - a for a, b in itertools.pairwise(frames)]
    first = [np.abs(step).mean() for step in steps]
    assert max(first) < 2.0 * np.mean(first)
    # the edge of a hard shadow crosses a pixel of opaque skin in one step; no more than these may jump
    assert max((np.abs(step).max(-1) > 0.35).mean() for step in steps) < 1e-3
    assert max(np.abs(b - a).mean() for a, b in itertools.pairwise(steps)) < most * np.mean(first)


def test_strands_are_lit_with_the_skin(session):
    bob = HairUse("groom:bob")
    lit, back = (
        drawn(session, LEFT, hair=bob),
        drawn(session, Lighting((Sun(direction=(-1.0, 0.0, 0.0), strength=3.0),)), hair=bob),
    )
    top = slice(0, 40)
    assert halves(lit["linear"][top, :, :3])[0] > 1.5 * halves(back["linear"][top, :, :3])[0]


def test_in_the_studios_rig_strands_look_as_unlit_ones(session, monkeypatch):
    monkeypatch.setattr(Wardrobe, "covering", lambda *_: (np.zeros((0, 3)), np.zeros((0, 3))))  # neither throws shadows on skin
    monkeypatch.setattr(wardrobe, "shadow", lambda there, settings: np.ones((len(there.under), 1), np.float32))
    session.evaluator.cache.clear()
    plain, lit = (drawn(session, light, hair=HairUse("groom:bob")) for light in (None, STUDIO))
    session.evaluator.cache.clear()
    crown = np.s_[:36]
    covered = lit["alpha"][crown][..., 0] > 0.9
    assert np.abs(lit["rgb"] - plain["rgb"])[crown][covered].mean() < 0.003


def test_light_on_strands_turns_smoothly_with_a_hard_sun(session):
    suns = (Sun(direction=(math.sin(turn), 0.3, math.cos(turn)), strength=3.0) for turn in np.radians(np.arange(60.0, 76.0)))
    crown = np.s_[:36]
    passes = [drawn(session, Lighting((sun,)), hair=HairUse("groom:bob")) for sun in suns]
    steps = [np.abs(b["rgb"] - a["rgb"])[crown].max(-1) for a, b in itertools.pairwise(passes)]
    strands = passes[0]["hair"][crown][..., 0] > 0.5
    assert max(step[strands].max() for step in steps) < 0.02
    assert max(step.max() for step in steps) < 0.1  # skin at the hairline has sharper shadows


def test_strands_throw_shadows_on_the_skin(session, monkeypatch):
    above, hair = Lighting((Sun(direction=(0.5, 0.8, 0.33), strength=3.0),)), HairUse("groom:bob")
    shaded = drawn(session, above, hair=hair)["shadow"]
    monkeypatch.setattr(Wardrobe, "covering", lambda *_: (np.zeros((0, 3)), np.zeros((0, 3))))
    session.evaluator.cache.clear()
    lit = drawn(session, above, hair=hair)["shadow"]
    session.evaluator.cache.clear()
    assert (lit - shaded).max() > 0.3
    assert (shaded - lit).max() < 0.05


@pytest.mark.parametrize(
    "lighting",
    [
        Lighting((Point(strength=500.0, position=(0.0, 0.0, 0.0)),)),  # inside the head
        Lighting((), Surroundings.even((0.0, 0.0, 0.0))),
        Lighting(),
        Lighting(tuple(Spot(strength=1.0, position=(0.0, 0.0, 1.0 + 0.001 * i)) for i in range(1000))),
    ],
    ids=["inside", "black world", "nothing", "a thousand"],
)
def test_odd_light_is_a_picture(session, lighting):
    lit = drawn(session, lighting)
    for name in PASSES:
        assert np.isfinite(lit[name]).all(), name


def test_light_that_lies_on_the_skin_turns_with_it(session):
    """Half the light on the person's left, as a photo had it there."""
    head = session.engine.store.default().model.head_model
    local = np.where(head.v_template[:, :1] > 0.0, 0.5, 1.0) * np.ones(3)
    for controls in (Controls(), Controls().set_named({"neck.y": 0.3})):
        even, lies = (drawn(session, replace(STUDIO, local=one), MATT, controls) for one in (local[:0], local))
        ratio = lies["linear"][..., :3].sum(-1) / even["linear"][..., :3].sum(-1).clip(1e-6)
        nose = round(float(CAMERA.project(session.deform(session.open("default").id, controls).vertices)[1][:, 0].mean()))
        shown = even["alpha"][..., 0] > 0.99
        left, right = ratio[:, nose + 25 :][shown[:, nose + 25 :]], ratio[:, : nose - 25][shown[:, : nose - 25]]
        np.testing.assert_allclose([np.median(left), np.median(right)], [0.5, 1.0], atol=0.02)


def test_fine_light_lies_on_the_texels(session):
    """A dark stripe that is narrower than the faces of the mesh."""
    model = session.engine.store.default().model
    head, layout = model.head_model, model.layout
    places = (head.v_template[head.faces[layout.face]] * layout.barycentric[..., None]).sum(1)
    stripe = np.where(np.abs(places[:, 1:2] - places[places[:, 2].argmax(), 1] - 0.05) < 0.0015, 0.3, 1.0) * np.ones(3)
    even, lies = (drawn(session, replace(STUDIO, fine=one), MATT)["linear"][..., :3].sum(-1) for one in (stripe[:0], stripe))
    ratio, face = lies / even.clip(1e-6), even > 0.3 * even.max()
    assert ratio[face].min() < 0.6
    dark = (ratio < 0.8) & face
    assert 0 < dark.any(1).sum() < 0.1 * face.any(1).sum()
    np.testing.assert_allclose(np.median(ratio[face]), 1.0, atol=1e-3)


def test_fine_light_of_other_weights_does_not_count(session):
    """An avatar that was carried over has other texels than its file says."""
    even, other = (drawn(session, replace(STUDIO, fine=one), MATT)["rgb"] for one in (np.ones((0, 3)), np.zeros((9, 3))))
    np.testing.assert_array_equal(even, other)


def test_light_that_lies_on_another_head_is_refused(session):
    with pytest.raises(ShapeError, match="another head"):
        drawn(session, replace(STUDIO, local=np.ones((7, 3))), MATT)


def test_light_reaches_a_worker():
    spots = Surroundings.of_picture(np.maximum(np.random.default_rng(0).random((16, 32, 3)), 0.2))
    light = Lighting((soft_box(30, 20, 1.0, 0.3, 40.0, (1.0, 0.5, 0.2)), *LEFT.lamps), spots, np.zeros((1, 3, 3)))
    light = replace(light, local=np.full((load_open_head().vertex_count, 3), 0.7))
    with create_session("local", engine="plain") as here, create_session("worker", engine="plain") as worker:
        light = replace(light, fine=np.full((len(here.engine.store.default().model.layout.face), 3), 0.8))
        np.testing.assert_allclose(drawn(worker, light)["rgb"], drawn(here, light)["rgb"], atol=1e-6)
