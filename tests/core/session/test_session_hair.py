"""Strands in sessions: worn by any avatar, drawn with its skin, in files and passes, with sentences for what cannot be worn."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from support.tiny_model import write_tiny_weights

from grmm_core.avatar import Hair, load_avatar, save_avatar
from grmm_core.avatar.deltas import APPEARANCE, rounded
from grmm_core.avatar.library import library_path
from grmm_core.controls.frame import Controls
from grmm_core.errors import ConfigError, FileAccessError, ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.drawing import StrandGaussians, nearer
from grmm_core.hair.ribbons import Eye
from grmm_core.hair.roots import BEARD, BROWS
from grmm_core.hair.strands import StrandBlock
from grmm_core.head import load_people_model
from grmm_core.light.parse import lighting_of
from grmm_core.light.relight import to_linear
from grmm_core.light.shading import Response
from grmm_core.session import FINAL_STRANDS, HairUse, Instance, RenderOptions, create_session
from grmm_core.session.random_hair import random_hair
from grmm_core.session.swinging import swinging

CAMERA = Camera.orbit(160, 160, 20, fov=24)
BOB = HairUse("groom:bob")
NONE = HairUse("none", brows="none", beard="none", lashes="none")


@pytest.fixture(scope="module", params=["torch", "plain"])
def session(request):
    with create_session("local", engine=request.param) as session:
        yield session


def drawn(session, use: HairUse, camera: Camera = CAMERA, passes=("rgb", "alpha", "hair"), **options) -> dict[str, np.ndarray]:
    info = session.open("default")
    return session.render([Instance(info.id, hair=use)], camera, RenderOptions(passes=passes, **options))


def test_the_hair_pass_is_the_cover_of_the_strands(session):
    own, bob, bald = (drawn(session, use) for use in (HairUse(), BOB, NONE))
    assert own["hair"].max() > 0.9
    assert not bald["hair"].any()
    behind = drawn(session, BOB, Camera.orbit(160, 160, 180, fov=24))
    skin = behind["alpha"] > 0.5
    assert float((behind["hair"][skin] > 0.5).mean()) > 0.5  # from behind a bob hides most of head and neck
    assert 0.2 * behind["hair"].sum() < bob["hair"].sum() < 0.8 * behind["hair"].sum()  # a face is in front of it
    assert (bob["hair"] <= bob["alpha"] + 1e-4).all()
    black = drawn(session, HairUse("groom:bob", HairSettings(melanin=1.0)))
    blond = drawn(session, HairUse("groom:bob", HairSettings(melanin=0.05)))
    hair = bob["hair"][..., 0] > 0.9
    assert blond["rgb"][hair].mean() > black["rgb"][hair].mean() + 0.15


def strand_contrast(picture: dict[str, np.ndarray]) -> tuple[float, float]:
    """Brightness of hair and how much of it neighbouring rows of pixels differ from their mean, in the mean."""
    linear, hair = to_linear(picture["rgb"]).mean(-1), picture["hair"][..., 0] > 0.95
    inside = hair[:, 1:-1] & hair[:, 2:] & hair[:, :-2]
    fine = linear[:, 1:-1] - 0.5 * (linear[:, 2:] + linear[:, :-2])
    mean = float(linear[:, 1:-1][inside].mean())
    return mean, float(np.abs(fine[inside]).mean()) / mean


@pytest.mark.parametrize("words", [(), ("lamp:100,25,40", "world:0.2")])
def test_single_strands_stand_out_in_the_studios_light_and_in_a_lamps(monkeypatch, words):
    use, camera = HairUse("groom:long", HairSettings(melanin=0.8)), Camera.orbit(360, 360, 90, fov=20)

    def look() -> tuple[float, float]:
        with create_session("local", engine="plain") as session:
            response = Response() if words else None
            instance = Instance(session.open("default").id, hair=use, response=response)
            options = RenderOptions(
                passes=("rgb", "hair"), strands=FINAL_STRANDS, lighting=lighting_of(words) if words else None
            )
            return strand_contrast(session.render([instance], camera, options))

    bright, contrast = look()
    monkeypatch.setattr(StrandBlock, "crowded", lambda block, points, axes: np.ones((len(block), block.segments), np.float32))
    even, smooth = look()
    assert contrast > 1.2 * smooth
    assert bright == pytest.approx(even, rel=0.35)


def test_an_avatar_draws_what_it_drew_before_while_it_wears_its_own(session):
    before = drawn(session, HairUse())
    drawn(session, BOB)
    np.testing.assert_array_equal(drawn(session, HairUse())["rgb"], before["rgb"])


def test_hair_follows_the_neck(session):
    info = session.open("default")
    turned = Controls().set_named({"neck.y": 0.4})
    faces = [
        session.render([Instance(info.id, c, hair=BOB)], CAMERA, RenderOptions(passes=("hair",))) for c in (Controls(), turned)
    ]
    assert float(np.abs(faces[0]["hair"] - faces[1]["hair"]).mean()) > 0.01


def test_skin_is_laid_flat_for_what_is_worn_and_not_for_what_was_worn_before(session):
    """Two caps of one person, as of a photo's own hair and of another groom, one drawn after the other."""
    target = session.target(session.open("default").id)
    inputs, none = session.evaluator.inputs(target, Controls()), np.zeros(target.model.gaussian_count, np.float32)
    half = none.copy()
    half[: len(half) // 2] = 1.0
    with session.engine.calling():
        placed = [
            np.asarray(session.evaluator.geometry(target, inputs, session.engine.array(flat)).means) for flat in (half, none)
        ]
    moved = np.abs(placed[0] - placed[1]).max(1)
    assert moved[: len(half) // 2].max() > 1e-4
    assert moved[len(half) // 2 :].max() < 1e-7


def test_playback_of_swinging_hair_holds_no_more_from_frame_to_frame(session):
    """All that stays of a frame is in the cache, which is bounded: objects and arrays beside it stay as many."""
    info, frames, held = session.open("default"), [], []
    for t in np.arange(9) / 24.0:
        frames.append(Controls().set_named({"neck.y": 0.4 * float(np.sin(9.0 * t)), "jawOpen": 0.5 * float(t)}))
    camera, cache = Camera.orbit(48, 48, 20, fov=24), session.evaluator.cache
    tracemalloc.start()
    try:
        uses = swinging(session, info, HairUse("groom:long"), frames, 24.0)
        for number, (controls, use) in enumerate(zip(frames, uses, strict=True)):
            session.render([Instance(info.id, controls, hair=use)], camera, RenderOptions())
            assert cache.size <= cache.limit
            if number in (3, 8):
                cache.clear()
                gc.collect()
                held.append((len(gc.get_objects()), tracemalloc.get_traced_memory()[0]))
    finally:
        tracemalloc.stop()
    assert use.swing is not None
    assert use.swing.nbytes > 1 << 18  # of one of the arrays that a frame makes
    assert held[1][0] < held[0][0] + 60
    assert held[1][1] < held[0][1] + (1 << 19)


def test_two_heads_hide_each_other_with_their_hair(session):
    info = session.open("default")
    behind = np.eye(4)
    behind[2, 3] = -0.6
    both = session.render(
        [Instance(info.id, hair=BOB), Instance(info.id, model_to_world=behind, hair=HairUse("groom:crop"))],
        Camera.orbit(160, 160, fov=24), RenderOptions(passes=("mask", "alpha", "hair", "rgb")),
    )  # fmt: skip
    np.testing.assert_allclose(both["mask"].sum(-1), both["alpha"][..., 0], atol=2e-3)
    assert (both["hair"] <= both["alpha"] + 1e-4).all()


def test_a_file_holds_the_hair(session, tmp_path):
    info = session.open("default")
    use = HairUse("groom:bob", HairSettings(melanin=0.2, length=0.8))
    session.save(info.id, tmp_path / "bob.grmm", use)
    session.save(info.id, tmp_path / "plain.grmm")
    assert (tmp_path / "bob.grmm").stat().st_size - (tmp_path / "plain.grmm").stat().st_size < 1 << 20
    found = session.open(tmp_path / "bob.grmm")
    assert found.hair == use.settings
    assert session.open(tmp_path / "plain.grmm").hair == info.hair
    again = session.render([Instance(found.id)], CAMERA, RenderOptions(passes=("rgb", "hair")))
    worn = drawn(session, use)
    assert float(np.abs(again["hair"] - worn["hair"]).mean()) < 0.01
    assert float(np.abs(again["rgb"] - worn["rgb"]).mean()) < 0.01


def test_curves_made_of_a_photos_hair_look_like_it_until_they_are_cut_or_dyed(session, tmp_path):
    """The skin under a photo's own hair shows that hair; under what a host made of it, too, where it still stands."""
    groom, plain = library_groom("crop"), load_avatar(library_path("default"))
    settings = HairSettings(melanin=1.0)
    person = replace(plain, hair=Hair(groom, settings), provenance=replace(plain.provenance, from_photos=True))
    save_avatar(person, tmp_path / "photo.grmm")
    number = session.open(tmp_path / "photo.grmm").id
    stored = session.target(number).avatar.hair.groom
    head = session.target(number).model.head_model
    roots = stored.frames(np.asarray(head.v_template, float), head.faces).at(np.asarray(head.v_template, float))[0]
    made = session.put_groom("made of it", "1", stored)
    cut = session.put_groom("cut", "1", stored.select((stored.groups != 0) | (roots[:, 0] < 0)))

    def shown(use: HairUse) -> np.ndarray:
        return session.render([Instance(number, hair=use)], CAMERA)["rgb"]

    def skin(use: HairUse) -> np.ndarray:
        colors = session.gaussians(number, Controls(), hair=use).colors
        return np.asarray(colors)[: len(session.target(number).model.layout)]

    own, same = HairUse(settings=settings), HairUse(made, settings, of_own=True)
    np.testing.assert_array_equal(shown(same), shown(own))
    assert np.abs(shown(HairUse(made, settings)) - shown(own)).mean() > 1e-4  # somebody else's hair of the same shape
    kept, shorn, other = (skin(use) for use in (same, HairUse(cut, settings, of_own=True), HairUse(cut, settings)))
    layout = session.target(number).model.layout
    side = (np.asarray(head.v_template)[np.asarray(head.faces)[layout.face]] * layout.barycentric[..., None]).sum(1)[:, 0]
    np.testing.assert_allclose(shorn[side < -0.04], kept[side < -0.04], atol=5e-3)
    scalp = (head.marked("scalp").astype(float)[np.asarray(head.faces)[layout.face]] * layout.barycentric).sum(1) > 0.99
    gone = scalp & (side > 0.04)
    assert np.abs(kept[gone] - other[gone]).mean() > 0.01
    np.testing.assert_allclose(shorn[gone], other[gone], atol=5e-3)
    dyed = settings.changed(melanin=0.1)
    np.testing.assert_allclose(skin(HairUse(settings=dyed))[scalp], skin(HairUse(made, dyed))[scalp], atol=5e-3)


def test_brows_lashes_and_beard_are_chosen_beside_the_hairstyle(session, tmp_path):
    info = session.open("default")
    face = Camera.orbit(160, 160, 0, distance=0.5, fov=24)
    bearded = replace(NONE, brows="bushy", beard="full")
    none, some = (drawn(session, use, face) for use in (NONE, bearded))
    assert not none["hair"].any()
    rows = some["hair"][..., 0].sum(1)
    assert rows[:80].max() > 2.0  # brows
    assert rows[100:].max() > 10.0  # beard
    np.testing.assert_allclose(some["alpha"][:20], none["alpha"][:20], atol=1e-3)  # the scalp stays bald
    grey = drawn(session, replace(bearded, parts={"beard": HairSettings(melanin=0.0, grey=1.0)}), face)
    assert grey["rgb"][100:].sum() > some["rgb"][100:].sum() + 10
    np.testing.assert_allclose(grey["rgb"][:60, 65:95], some["rgb"][:60, 65:95], atol=0.02)  # between the sideburns
    session.save(info.id, tmp_path / "bearded.grmm", bearded)
    again = session.render(
        [Instance(session.open(tmp_path / "bearded.grmm").id)], face, RenderOptions(passes=("hair", "alpha"))
    )
    assert float(np.abs(again["hair"] - some["hair"]).mean()) < 5e-3
    np.testing.assert_allclose(again["alpha"][:20], none["alpha"][:20], atol=1e-3)
    for use in (HairUse(brows="bob"), HairUse(lashes="wig")):
        with pytest.raises(FileAccessError, match="groom of"):
            drawn(session, use)
    with pytest.raises(ShapeError, match="no part 'nose'"):
        HairUse(parts={"nose": HairSettings()})


def test_heads_trained_without_hair_have_brows_and_lashes_unless_their_file_says_else(session, tmp_path):
    plain = replace(load_avatar(library_path("default")), hair=None)
    save_avatar(plain, tmp_path / "plain.grmm")
    save_avatar(replace(plain, hair=Hair(library_groom("crop"), HairSettings())), tmp_path / "browless.grmm")
    face, own = Camera.orbit(160, 160, 0, distance=0.5, fov=24), HairUse()

    def hair(name: str, use: HairUse = own) -> np.ndarray:
        instance = Instance(session.open(tmp_path / f"{name}.grmm").id, hair=use)
        return session.render([instance], face, RenderOptions(passes=("hair",)))["hair"]

    usual = hair("plain")
    np.testing.assert_array_equal(usual, hair("plain", HairUse(brows="natural", lashes="natural")))
    assert usual[:80].sum() > 50
    assert not usual[110:].any()
    assert not hair("plain", HairUse(brows="none", lashes="none")).any()
    crop = hair("browless")
    assert crop[:20].sum() > 50
    assert crop[40:80, 70:90].sum() < 1  # the record has no brows


def test_random_people_of_heads_without_hair_wear_some_of_their_seed(session):
    one, other = session.sample(72), session.sample(-73)
    assert one.hair != other.hair
    hair = session.target(one.id).avatar.hair
    assert set(np.unique(hair.groom.groups)) == {0, 1, 3}
    seen = session.render([Instance(one.id)], CAMERA, RenderOptions(passes=("hair",)))["hair"]
    assert seen.max() > 0.5
    for info in (one, other):
        session.release(info.id)


def test_points_that_a_host_moved_are_drawn_where_they_are(session):
    info = session.open("default")
    groom = library_groom("crop")
    worn = session.put_groom("moved", "1", groom)
    head = session.target(info.id).model.head_model
    vertices = session.deform(info.id, Controls()).vertices
    points = groom.posed(groom.frames(np.asarray(head.v_template), head.faces), vertices)
    still, given = (drawn(session, HairUse(worn, None, part)) for part in (None, points))
    assert float(np.abs(still["hair"] - given["hair"]).mean()) < 5e-3
    lifted = drawn(session, HairUse(worn, None, points + np.array([0, 0.05, 0])))
    assert float(np.abs(still["hair"] - lifted["hair"]).mean()) > 0.02
    with pytest.raises(ShapeError, match="moved points"):
        drawn(session, HairUse(worn, None, points[:-3]))


def test_exports_have_the_strands(session):
    info = session.open("default")
    bare, dressed = (session.gaussians(info.id, Controls(), hair=use) for use in (HairUse("none"), BOB))
    again = session.gaussians(info.id, Controls(), np.array([1.0, 0.0, 0.0]), hair=BOB)
    assert len(dressed.means) > len(bare.means) + 20000
    np.testing.assert_array_equal(again.means, dressed.means)  # views differ in colors alone
    assert np.abs(again.colors - dressed.colors).max() > 0.02


def test_nothing_pops_in_a_zoom(session):
    """From one step of a zoom to the next, pictures brought to one size change little, and no step much more than others."""
    steps = []
    for width in np.geomspace(60, 240, 16):
        camera = Camera.orbit(256, 256, 40, fov=24)
        camera = replace(camera, fx=camera.fx * width / 256, fy=camera.fy * width / 256)
        steps.append(float(drawn(session, BOB, camera, refine=False)["hair"].sum()) / width**2)
    change = np.abs(np.diff(steps)) / np.mean(steps)
    assert change.max() < 0.03


def test_a_frame_of_playback_keeps_the_look_of_hair_with_fewer_strands(session):
    camera = Camera.orbit(256, 256, 20, fov=24)
    full, fewer = (drawn(session, HairUse(), camera, refine=False, strands=share) for share in (1.0, 0.4))
    assert full["hair"].sum() == pytest.approx(fewer["hair"].sum(), rel=0.06)
    assert 1e-4 < np.abs(full["rgb"] - fewer["rgb"]).mean() < 0.012
    bald = [drawn(session, NONE, camera, refine=False, strands=share)["rgb"] for share in (1.0, 0.4)]
    np.testing.assert_array_equal(*bald)
    with pytest.raises(ConfigError, match="share of the strands"):
        RenderOptions(strands=0.0)


def test_a_final_picture_has_finer_hair_of_the_same_look(session):
    camera = Camera.orbit(256, 256, 20, fov=24)
    plain, final = (drawn(session, BOB, camera, refine=False, strands=share) for share in (1.0, FINAL_STRANDS))
    assert final["hair"].sum() == pytest.approx(plain["hair"].sum(), rel=0.06)
    assert 1e-4 < np.abs(final["rgb"] - plain["rgb"]).mean() < 0.012
    with pytest.raises(ConfigError, match="share of the strands"):
        RenderOptions(strands=9.0)


def test_a_frame_of_playback_leaves_out_what_the_head_hides_and_shows_it_elsewhere(session):
    """A small part of the Gaussians far behind the skin shines through; a mouth, eyes and an outline stay as they are."""
    for yaw in (0, 140):
        camera = Camera.orbit(192, 192, yaw, fov=24)
        whole, played = (
            drawn(session, NONE, camera, ("rgb", "alpha", "raw"), strands=share, coarse=True) for share in (1.0, 0.4)
        )
        change = np.abs(whole["raw"] - played["raw"])
        assert 0.0 < change.mean() < 1e-3
        assert (change.max(-1) > 0.03).mean() < 5e-3
        assert np.abs(whole["alpha"] - played["alpha"]).mean() < 2e-3


def test_what_cannot_be_worn_is_said_and_the_avatar_still_draws(session):
    for use, error in (
        (HairUse("groom:nothing"), FileAccessError),
        (HairUse("put:nothing"), ShapeError),
        (HairUse("wig"), ShapeError),
    ):
        with pytest.raises(error, match="There is no"):
            drawn(session, use)
    groom = library_groom("buzz")
    other = replace(groom, triangles=groom.triangles + 10**6)
    with pytest.raises(ShapeError, match="use its own head"):
        drawn(session, HairUse(session.put_groom("other", "1", other)))
    with pytest.raises(ShapeError, match="finite"):
        HairUse(points=np.full((3, 3), np.nan))
    assert drawn(session, HairUse())["alpha"].max() > 0.9


@pytest.mark.parametrize("engine", ["torch", "plain"])
def test_strands_lie_on_weights_whose_texels_are_their_own(engine, tmp_path):
    weights = write_tiny_weights(tmp_path / "focused.safetensors", focus=True, hairless=True)
    with create_session("local", engine=engine, weights=weights) as session:
        info = session.open("default")
        bare, dressed = (session.gaussians(info.id, Controls(), hair=use) for use in (HairUse("none"), BOB))
        assert len(dressed.means) > len(bare.means) > info.gaussian_count // 2
        cover = session.render([Instance(info.id, hair=BOB)], CAMERA, RenderOptions(passes=("hair",)))["hair"]
    assert float((cover > 0.5).mean()) > 0.05


def test_brows_are_seen_at_coarser_levels_of_detail(session):
    camera = Camera.orbit(240, 240, 20)
    covers = []
    for level in (0, 1, 2):
        brows = HairUse("none", beard="none", lashes="none")
        with_brows, without = (drawn(session, use, camera, ("rgb",), lod=level, refine=False)["rgb"] for use in (brows, NONE))
        covers.append(np.clip(without - with_brows, 0.0, None).sum())
    assert covers[1] > 0.7 * covers[0]
    assert covers[2] > 0.6 * covers[0]


def test_what_is_moved_nearer_to_an_eye_is_seen_where_it_was():
    generator = np.random.default_rng(0)
    points = generator.normal(scale=0.1, size=(50, 3)).astype(np.float32)
    rest = *(np.zeros((50, k), np.float32) for k in (4, 3)), np.ones(50, np.float32), points, np.ones((50, 1), np.float32)
    made = StrandGaussians(points, *rest)
    for flat in (False, True):
        camera = replace(Camera.orbit(100, 100, 30, 10), orthographic=flat)
        before, after = (camera.project(each) for each in (points, nearer(made, Eye.of(camera), 0.01).means))
        np.testing.assert_allclose(after[1], before[1], atol=1e-3)
        assert (before[0][:, 2] - after[0][:, 2] > 0.009).all()


def test_black_brows_are_darker_than_dark_skin(session):
    near = Camera.orbit(200, 200, 0, fov=7, target=(0.0, 0.03, 0.05))
    info, options = session.sample(5), RenderOptions(passes=("rgb", "hair"))
    black = HairSettings(melanin=1.0)
    worn, bare = (
        session.render([Instance(info.id, hair=HairUse("none", black, brows=brows, beard="none"))], near, options)
        for brows in ("bushy", "none")
    )
    brow = worn["hair"][..., 0] > 0.7
    assert brow.sum() > 100
    assert bare["rgb"][brow].mean() < 0.5
    assert worn["rgb"][brow].mean() < 0.63 * bare["rgb"][brow].mean()


def test_a_file_saved_without_a_photos_brows_has_none_painted_either(session, tmp_path):
    avatar = load_avatar(library_path("default"))
    target = session.target(session.open("default").id)
    head, layout = target.model.head_model, target.model.layout
    own = avatar.hair.groom.select(avatar.hair.groom.groups == BROWS)
    roots = own.frames(head.v_template, head.faces).at(np.asarray(head.v_template, float))[0]
    places = (np.asarray(head.v_template, float)[head.faces[layout.face]] * layout.barycentric[..., None]).sum(1)
    colors = avatar.deltas[APPEARANCE].copy()
    painted = np.sqrt(((places[:, None] - roots[::3]) ** 2).sum(2).min(1)) < 0.002
    colors[painted, :3] -= 0.3
    photo = replace(avatar, deltas={APPEARANCE: rounded(colors)}, provenance=replace(avatar.provenance, from_photos=True))
    save_avatar(photo, tmp_path / "photo.grmm")
    face = Camera.orbit(192, 192, distance=1.0, fov=12, target=(0.0, 0.04, 0.06))

    def shown(path, use):
        number = session.open(path).id
        picture = session.render([Instance(number, hair=use)], face, RenderOptions(refine=False))["rgb"]
        session.release(number)
        return picture

    plucked = replace(HairUse(), brows="none")
    number = session.open(tmp_path / "photo.grmm").id
    session.save(number, tmp_path / "plucked.grmm", plucked)
    session.release(number)
    before, bare = (shown(tmp_path / "photo.grmm", use) for use in (HairUse(), plucked))
    reopened = shown(tmp_path / "plucked.grmm", HairUse())
    brow = np.abs(bare - before).max(2) > 0.1
    assert brow.sum() > 100
    assert bare[brow].mean() > before[brow].mean() + 0.15
    np.testing.assert_allclose(reopened, bare, atol=0.03)
    assert not (load_avatar(tmp_path / "plucked.grmm").hair.groom.groups == BROWS).any()


def test_random_people_with_dark_skin_have_no_fair_hair(session):
    made = random_hair(12, 0.7, np.zeros(300)).settings
    assert made.melanin < 0.3  # the seed alone would give blond
    for seed in (12, 16):
        assert session.sample(seed).hair.melanin > 0.8


def test_random_men_may_have_beards_and_old_people_have_grey_hair():
    """By what shapes say: those of the open head's people, of one sex and of two ages."""
    people = load_people_model()

    def person(**macros):
        off = np.array([macros.get(name, mean) - mean for name, mean in zip(people.names, people.mean, strict=True)])
        return off @ people.macro_to_shape

    def of(shape):
        found = people.macros(shape)
        hair = [random_hair(seed, 0.7, shape) for seed in range(12)]
        bearded = np.mean([(made.groom.groups == BEARD).any() for made in hair])
        return found, bearded, np.mean([made.settings.grey for made in hair])

    man, woman, old = (of(person(**macros)) for macros in ({"female": 0.0}, {"female": 1.0}, {"age": 78.0}))
    assert man[0]["female"] < 0.2 < 0.8 < woman[0]["female"]
    assert old[0]["age"] > man[0]["age"] + 12.0
    assert 0.2 < man[1] < 0.95
    assert woman[1] == 0.0
    assert old[2] > man[2] + 0.25
