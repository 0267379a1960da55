"""Inversion (eq. 19 and 20) of pictures that a small model made itself: the person is known, and so is the way back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from model_fixtures import small_head
from progress_checks import check_progress

from grmm_core.avatar import load_avatar, save_avatar
from grmm_core.controls.frame import Controls, resolve
from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.errors import CancelledError, ConfigError, FileFormatError, ShapeError
from grmm_core.fitting.code_stage import code_prior
from grmm_core.fitting.decoder_stage import Tuner
from grmm_core.fitting.invert import invert, photo_error, photo_pictures
from grmm_core.fitting.locality import Locality, code_distances
from grmm_core.fitting.objective import decode, draw, photo_inputs
from grmm_core.fitting.photo_targets import fit_view, project
from grmm_core.fitting.presets import CodeSettings, DecoderSettings, Preset, preset_named
from grmm_core.fitting.recoloring import recolor, solve_maps, unchanged
from grmm_core.fitting.result import photo_camera, photo_controls
from grmm_core.fitting.surface import SKIN, texel_surface
from grmm_core.fitting.types import PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.jobs.progress import Progress, Reporter
from grmm_core.jobs.stages import FIT
from grmm_core.model.config import BASIS_COLOR
from grmm_core.model.config import PRESETS as MODEL_PRESETS
from grmm_core.model.grmm import GRMM
from grmm_core.model.torch_loader import with_deltas
from grmm_core.model.weights_file import WeightsInfo

pytestmark = pytest.mark.usefixtures("only_skin")
SIZE = 96
QUICK = Preset("quick", CodeSettings(64, 48, 4, 1, 0, 10), DecoderSettings(((64, 8), (96, 10)), False))
TUNING = Preset("tuning", CodeSettings(64, 48, 2, 1, 0, 2), DecoderSettings(((64, 12),), True))


@pytest.fixture(scope="module")
def person():
    """A model, what its weights file would say, and the code of somebody who is not among the training people."""
    torch.manual_seed(3)
    model = GRMM(small_head(), MODEL_PRESETS["tiny"].replace(grid=64, decoder_grid=16))
    with torch.no_grad():
        # colors that change over centimetres, as those of faces do
        places = model.anchor(model.head.v_template).positions * 40.0  # [N, 3]
        model.decoders.appearance_mean[:, :3] = 0.5 + 0.2 * torch.sin(places @ torch.randn(3, 3))
        for row in model.decoders.basis[BASIS_COLOR]:
            row.copy_(0.1 * torch.sin(places @ torch.randn(3, 3)).flatten())
        model.refinement.exit.weight.normal_(std=0.02)
    rng = np.random.default_rng(4)
    codes = rng.normal(size=(5, model.z_id_size)).astype(np.float32)
    info = WeightsInfo(
        "small", model.head_model.name, "", model.config, people=tuple("abcde"), z_id=codes,
        shapes=np.zeros((5, 4), np.float32), default_z_id=codes.mean(0), default_shape=np.zeros(4, np.float32),
    )  # fmt: skip
    return model.eval(), info, codes[1] * 0.6 + codes[3] * 0.4


def photo(model, z_id, yaw=0.0, gain=1.0, smile=0.0, brown=0.0):
    """A picture of a person with exact tracking."""
    head = model.head_model
    expression = np.zeros(head.expression_count, np.float32)
    expression[head.expression_names.index("mouthSmileLeft")] = smile
    shape, pose = np.zeros(head.shape_count, np.float32), np.zeros((5, 3), np.float32)
    camera = Camera.orbit(SIZE, SIZE, yaw=yaw, distance=0.9, fov=20.0)
    aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
    aligned[: len(expression)] = expression[: len(ALIGNED_NAMES)]
    with torch.no_grad():
        frame = (torch.tensor(array) for array in (z_id, shape, expression, pose, aligned))
        rendering = model.render(camera, model.performed(*frame))
    mask = rendering.alpha.numpy()
    image = rendering.image.numpy() * gain * np.array([1.0, 1.0 - 0.5 * brown, 1.0 - brown], np.float32)
    vertices = head.vertices(shape, expression, pose)
    landmarks = np.repeat(project(vertices[:1], camera), 478, 0)
    return PhotoTrack(
        source=f"yaw {yaw}.jpg", image=np.clip(image + 0.5 * (1 - mask[..., None]), 0, 1), mask=mask, valid=np.ones_like(mask),
        camera=camera, photo_camera=camera.resized(2 * SIZE, 2 * SIZE), shape=shape, expression=expression, pose=pose,
        landmarks=landmarks, landmarks_fitted=landmarks, arkit=expression[:52],
    )  # fmt: skip


def errors_of(pictures):
    return [photo_error(view, drawn) for view, drawn in pictures]


def test_both_stages_bring_the_avatar_nearer_to_the_photo(person):
    model, info, z_id = person
    before = {name: value.clone() for name, value in model.state_dict().items()}
    track = photo(model, z_id, brown=0.4)
    image = track.image.copy()
    image[42:54, 40:58] *= np.array([0.4, 0.7, 1.0], np.float32)  # a mark that no code and no color map explains
    tracks = [dataclasses.replace(track, image=image)]
    errors, coded = [], []
    for second in (False, True):
        avatar = invert(
            tracks, model, model.head_model, QUICK, info=info, second_stage=second, on_codes=coded.append
        )  # fmt: skip
        errors += errors_of(photo_pictures(with_deltas(model, avatar.deltas, "avatar"), avatar, tracks, SIZE))
    plain = dataclasses.replace(avatar, z_id=info.z_id.mean(0))
    start = errors_of(photo_pictures(model, plain, tracks, SIZE))[0]
    assert errors[0] < 0.6 * start
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.03
    for first in coded:  # told between the stages, whether there is a second or not
        again = errors_of(photo_pictures(with_deltas(model, first.deltas, "first"), first, tracks, SIZE))
        assert again[0] == pytest.approx(errors[0], rel=1e-3)
    assert set(avatar.deltas) == {f"decoders.{name}_mean" for name in ("transform", "opacity", "appearance")}
    for name, value in model.state_dict().items():
        assert torch.equal(value, before[name]), f"{name} of the shared model was changed"


def test_a_search_goes_on_from_the_code_that_tracking_found(person):
    """Its own start may be nobody's: the search neither tries people nor leaves it without a reason."""
    model, info, z_id = person
    begun = dataclasses.replace(photo(model, z_id), identity=(0.8 * info.z_id[2] + 0.2 * info.z_id[0]).astype(np.float32))
    for goes_on, near in ((True, True), (False, False)):
        codes = CodeSettings(64, 48, 4, 1, 0, 0, goes_on=goes_on)
        avatar = invert([begun], model, model.head_model, Preset("none", codes, QUICK.decoders), info=info, second_stage=False)
        assert np.allclose(avatar.z_id, begun.identity, atol=1e-3) == near
    avatar = invert(
        [begun], model, model.head_model, Preset("some", dataclasses.replace(QUICK.codes, goes_on=True), QUICK.decoders),
        info=info, second_stage=False,
    )  # fmt: skip
    assert np.linalg.norm(avatar.z_id - z_id) < 0.8 * np.linalg.norm(begun.identity - z_id)


def test_the_avatar_says_that_it_was_made_from_photos_and_knows_how_they_were(person, tmp_path):
    model, info, z_id = person
    tracks = [photo(model, z_id, yaw=20.0, smile=0.7)]
    avatar = invert(tracks, model, model.head_model, QUICK, info=info, second_stage=False, name="Ada")
    save_avatar(avatar, tmp_path / "ada.grmm")
    avatar = load_avatar(tmp_path / "ada.grmm")
    assert avatar.provenance.from_photos
    assert [record.name for record in avatar.provenance.photos] == ["yaw 20.0.jpg"]
    assert "agreement" in avatar.provenance.licence
    np.testing.assert_allclose(photo_camera(avatar).world_to_camera, tracks[0].photo_camera.world_to_camera, atol=1e-6)
    assert (avatar.camera.width, avatar.camera.fx) == (2 * SIZE, tracks[0].photo_camera.fx)
    resolved = resolve(photo_controls(avatar, model.head_model), model.head_model)
    np.testing.assert_allclose(resolved.expression, tracks[0].expression, atol=1e-6)
    assert not avatar.expression.any(), "the avatar rests with a neutral face"
    with pytest.raises(ShapeError, match="photo 2"):
        photo_controls(avatar, model.head_model, 1)


def test_changes_are_stored_in_half_precision_without_loss(person, tmp_path):
    model, info, z_id = person
    avatar = invert([photo(model, z_id)], model, model.head_model, QUICK, info=info)
    path = tmp_path / "a.grmm"
    save_avatar(avatar, path)
    loaded = load_avatar(path)
    values = sum(array.size for array in avatar.deltas.values())
    assert path.stat().st_size < 2.2 * values + 40_000
    for name, array in avatar.deltas.items():
        np.testing.assert_array_equal(loaded.deltas[name], array)
    odd = dataclasses.replace(avatar, deltas={"x": np.array([1.0, 1e-3 + 1e-9, 7e4], np.float32)})
    save_avatar(odd, path)
    np.testing.assert_array_equal(load_avatar(path).deltas["x"], odd.deltas["x"])


def test_several_photos_of_other_exposure_make_one_person(person):
    model, info, z_id = person
    tracks = [photo(model, z_id, yaw=-25.0), photo(model, z_id, yaw=25.0, gain=0.6, smile=0.5)]
    avatar = invert(tracks, model, model.head_model, QUICK, info=info)
    tuned = with_deltas(model, avatar.deltas, "avatar")
    assert max(errors_of(photo_pictures(tuned, avatar, tracks, SIZE))) < 0.05
    unseen = [photo(model, z_id, yaw=0.0)]  # between the photos
    between = dataclasses.replace(avatar, tracking={**avatar.tracking, "z_exp": np.zeros_like(avatar.tracking["z_exp"])})
    assert errors_of(photo_pictures(tuned, between, unseen, SIZE))[0] < 0.06


def test_a_shadow_that_one_of_two_photos_shows_alone_is_less_on_the_person(person, monkeypatch):
    model, info, z_id = person
    clean = photo(model, z_id, yaw=8.0)
    image = clean.image.copy()
    image[36:56, 40:56] *= 0.6
    other, shadowed = photo(model, z_id, yaw=-8.0), dataclasses.replace(clean, image=image)

    def error(second):
        avatar = invert([other, second], model, model.head_model, QUICK, info=info)
        return errors_of(photo_pictures(with_deltas(model, avatar.deltas, "avatar"), avatar, [clean], SIZE))[0]

    least, believed_less = error(clean), error(shadowed)
    monkeypatch.setattr(Tuner, "compare_photos", lambda self, level: None)
    assert believed_less - least < 0.85 * (error(shadowed) - least)


def test_cancel_leaves_a_state_from_which_the_fit_goes_on_to_the_same_result(person, tmp_path):
    model, info, z_id = person
    tracks = [photo(model, z_id, brown=0.3), photo(model, z_id, yaw=12.0)]
    whole = invert(tracks, model, model.head_model, TUNING, info=info)
    seen: list[Progress] = []
    stages = FIT.only(("codes", "decoders"))
    begin, end = stages.span("decoders")
    half = Reporter(stages, seen.append, lambda: bool(seen) and seen[-1].fraction >= 0.5 * (begin + end))
    with pytest.raises(CancelledError):
        invert(tracks, model, model.head_model, TUNING, info=info, work=tmp_path, report=half)
    check_progress(seen, stages)
    assert not list(tmp_path.glob("*.tmp"))
    seen.clear()
    resumed = invert(tracks, model, model.head_model, TUNING, info=info, work=tmp_path, report=Reporter(stages, seen.append))
    assert {one.stage for one in seen} == {"decoders"}, "stage 1 was done before"
    assert seen[0].fraction > 0.5 * (begin + end)
    check_progress(seen, stages)
    for name, array in whole.deltas.items():
        np.testing.assert_allclose(resumed.deltas[name], array, atol=2e-3, err_msg=name)
    # the state of another job is not taken
    seen.clear()
    other = [photo(model, z_id, brown=0.2)]
    invert(other, model, model.head_model, TUNING, info=info, work=tmp_path, report=Reporter(stages, seen.append))
    assert "codes" in {one.stage for one in seen}


def test_a_damaged_state_is_done_anew(person, tmp_path):
    model, info, z_id = person
    tracks = [photo(model, z_id)]
    first = invert(tracks, model, model.head_model, TUNING, info=info, work=tmp_path)
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:-100])
    again = invert(tracks, model, model.head_model, TUNING, info=info, work=tmp_path)
    np.testing.assert_allclose(again.z_id, first.z_id, atol=1e-4)


def test_networks_are_tuned_and_locality_holds_them(person):
    model, info, z_id = person
    tracks = [photo(model, z_id, brown=0.5)]
    prior = code_prior(info, model)
    changes = []
    for weight in (0.0, 30.0):
        avatar = invert(tracks, model, model.head_model, TUNING, info=info, locality=weight)
        networks = {name: value for name, value in avatar.deltas.items() if not name.endswith("_mean")}
        assert any(np.abs(value).max() > 0 for value in networks.values())
        tuned = with_deltas(model, networks, "avatar")
        rng = torch.Generator().manual_seed(11)
        moved = 0.0
        for _ in range(6):  # other people
            code, z_exp = prior.code(torch.randn(len(prior.directions), generator=rng)), torch.zeros(model.z_exp_size)
            with torch.no_grad():
                moved += float((tuned.offsets(code, z_exp) - model.offsets(code, z_exp)).abs().mean())
        changes.append(moved)
    assert changes[1] < 0.8 * changes[0]


def test_locality_codes_are_at_the_documented_distance(person):
    model, info, z_id = person
    prior = code_prior(info, model)
    view = fit_view(photo(model, z_id), model.head_model, 0, 64, len(ALIGNED_NAMES), model.dtype)
    fitted = torch.tensor(z_id)
    inputs = dataclasses.replace(photo_inputs(model, view, fitted, None), z_exp=torch.zeros(model.z_exp_size))
    codes = type("Fitted", (), {"z_id": fitted, "inputs": lambda self, model, view: inputs})()
    locality = Locality(model, prior, codes, view)
    id_distance, exp_distance = code_distances(model, prior)
    spread = np.sqrt(2.0 * np.var(info.z_id, axis=0, ddof=1).sum())
    assert id_distance == pytest.approx(0.5 * spread, rel=1e-4)
    for number, (near, _) in enumerate(locality.bank):
        assert float((near.z_id - fitted).norm()) == pytest.approx(0.0 if number % 2 else id_distance, abs=1e-4)
        assert float(near.z_exp.norm()) == pytest.approx(exp_distance, rel=1e-3)
        assert float(locality(model, number).detach()) == 0.0


def test_color_maps_are_found_exactly(person):
    model, _, z_id = person
    surface = texel_surface(model)
    view = fit_view(photo(model, z_id), model.head_model, 0, 96, len(ALIGNED_NAMES), model.dtype)
    code = torch.tensor(z_id)
    with torch.no_grad():
        inputs = photo_inputs(model, view, code, None)
        vertices, look = model.mesh(inputs).vertices, decode(model, inputs, view.camera)
        wanted = unchanged(code)
        wanted[SKIN] = torch.tensor([[0.7, 0.05, 0.0], [0.0, 0.8, 0.1], [0.05, 0.0, 0.5], [0.1, 0.02, -0.03]])
        drawn = draw(model, view.camera, vertices, look.recolored(recolor(look.colors, wanted, surface)), refined=False)
        picture = drawn.raw / drawn.alpha[..., None].clamp(min=1e-3)
        target = dataclasses.replace(view, image=picture, mask=(drawn.alpha > 0.9).to(code))
        found = solve_maps(model, [target], [vertices], [look], surface, [torch.ones_like(picture)], torch.ones(1))
        shown = draw(model, view.camera, vertices, look.recolored(recolor(look.colors, found, surface)), refined=False).raw
    assert float((shown - drawn.raw)[target.mask > 0].abs().mean()) < 0.01


def test_filling_spreads_from_seen_to_unseen_texels_and_over_the_plane_of_symmetry(person):
    model, _, _ = person
    surface = texel_surface(model)
    x = model.anchor(model.head.v_template).positions[:, 0]
    count = model.gaussian_count
    values = torch.where(x > 0.02, 1.0, 0.0)[:, None]
    seen = (x > 0.02).to(values.dtype)
    filled = surface.fill(values, seen)
    assert float((filled[seen > 0] - 1.0).abs().max()) < 0.05
    assert float(filled[(x < -0.03)].mean()) > 0.7, "the mirrored side takes over"
    assert float(surface.fill(torch.ones(count, 1), torch.zeros(count)).abs().max()) == 0.0, "nothing seen changes nothing"


def test_clothes_are_no_target_but_the_background_beside_the_head_is(person):
    model, _, z_id = person
    track = photo(model, z_id)
    mask = track.mask.copy()
    mask[-20:] = 1.0  # shoulders wider than the model
    lower = np.array(track.landmarks_fitted)
    lower[:, 1] = 60.0  # the chin
    track = dataclasses.replace(track, mask=mask, landmarks_fitted=lower)
    view = fit_view(track, model.head_model, 0, SIZE, len(ALIGNED_NAMES), model.dtype)
    assert float(view.weight[-1, 0]) == 0.0
    assert float(view.weight[0, 0]) == 1.0
    assert float(view.weight[view.weight.shape[0] // 2, view.weight.shape[1] // 2]) == 1.0


def test_an_avatar_may_bring_mean_maps_to_a_model_without(person):
    head = small_head()
    torch.manual_seed(0)
    plain = GRMM(head, MODEL_PRESETS["tiny"].replace(mean_maps=False))
    change = np.zeros((plain.gaussian_count, 1), np.float32)
    change[3] = 2.0
    code = torch.zeros(plain.z_id_size)
    changed = with_deltas(plain, {"decoders.opacity_mean": change}, "avatar")
    with torch.no_grad():
        difference = changed.decoders.opacity_logits(code) - plain.decoders.opacity_logits(code)
    np.testing.assert_allclose(difference.numpy(), change[:, 0], atol=1e-5)
    with pytest.raises(FileFormatError, match="opacity_mean"):
        with_deltas(plain, {"decoders.opacity_mean": change[:-1]}, "avatar")


def test_wrong_arguments_are_refused_in_one_sentence(person):
    model, info, z_id = person
    track = photo(model, z_id)
    with pytest.raises(ConfigError, match="at least one"):
        invert([], model, model.head_model, QUICK, info=info)
    with pytest.raises(ConfigError, match="at least one"):
        invert([track], model, model.head_model, QUICK)
    with pytest.raises(ConfigError, match="no preset 'quickest'"):
        preset_named("quickest")


def test_controls_of_a_photo_are_controls(person):
    model, info, z_id = person
    avatar = invert([photo(model, z_id)], model, model.head_model, QUICK, info=info, second_stage=False)
    assert isinstance(photo_controls(avatar, model.head_model), Controls)
