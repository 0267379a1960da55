"""The in-process session from inside: what is computed anew, what the cache keeps, where networks run."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from grmm_core.avatar import load_avatar, save_avatar
from grmm_core.controls.frame import Controls
from grmm_core.errors import ConfigError, RuntimeMissingError
from grmm_core.geometry.camera import Camera
from grmm_core.light.cornea import on_eyes
from grmm_core.session import PASS_NAMES, Instance, RenderOptions, create_session, make_local_session

SIZE = 96
CAMERA = Camera.orbit(SIZE, SIZE)


def moved(x: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix


def all_passes(session, instances):
    return session.render(instances, CAMERA, RenderOptions(passes=PASS_NAMES))


def test_refining_the_covered_part_changes_nothing(local, monkeypatch):
    from grmm_core.session import refining

    instance = Instance(local.open("default").id, model_to_world=moved(0.05))
    camera = Camera.orbit(240, 176)
    cropped = local.render([instance], camera)["rgb"]
    regions = []
    original = refining.covered_region

    def whole(cover, config, coarse):
        regions.append(original(cover, config, coarse))
        return slice(0, cover.shape[0]), slice(0, cover.shape[1])

    monkeypatch.setattr(refining, "covered_region", whole)
    np.testing.assert_allclose(local.render([instance], camera)["rgb"], cropped, atol=1e-6)
    assert regions[0][1].start > 0


@pytest.mark.parametrize("channels", [(6,), (6, 5), (6, 5, 4), (6, 5, 4, 3)])
@pytest.mark.parametrize("fold", [1, 2])
def test_the_margin_is_as_wide_as_the_network_sees(channels, fold):
    import torch

    from grmm_core.model.config import PRESETS
    from grmm_core.model.refine import RefinementNetwork
    from grmm_core.session.refining import covered_region

    torch.manual_seed(0)
    config = PRESETS["tiny"].replace(refine_channels=channels, refine_unshuffle=fold)
    network = RefinementNetwork(config)
    torch.nn.init.normal_(network.exit.weight)
    alpha = torch.zeros(230, 310)
    alpha[111:120, 150:163] = 1.0
    rgb, features = torch.rand(230, 310, 3) * alpha[..., None], torch.rand(230, 310, config.features) * alpha[..., None]
    with torch.no_grad():
        whole = network(rgb, features, alpha, alpha)
        rows, columns = covered_region(alpha, config)
        part = network(rgb[rows, columns], features[rows, columns], alpha[rows, columns], alpha[rows, columns])
    assert part.numel() < whole.numel()
    np.testing.assert_allclose(part, whole[rows, columns], atol=1e-5)


@pytest.mark.parametrize("engine", ["torch", "plain"])
def test_only_what_changed_is_computed(weights, engine, monkeypatch):
    from grmm_core.inference.plain_model import PlainModel
    from grmm_core.model.grmm import GRMM

    calls = []
    for model, name in itertools.product((GRMM, PlainModel), ("opacity", "appearance", "offsets", "mesh", "geometry")):
        original = getattr(model, name)

        def counted(self, *args, name=name, original=original):
            calls.append(name)
            return original(self, *args)

        monkeypatch.setattr(model, name, counted)
    with make_local_session(weights, "cpu", 1, engine=engine) as session:
        info = session.sample(501)
        session.render([Instance(info.id)], CAMERA)
        assert sorted(calls) == ["appearance", "geometry", "mesh", "offsets", "opacity"]
        calls.clear()
        session.render([Instance(info.id)], CAMERA)
        assert calls == []
        session.render([Instance(info.id)], Camera.orbit(SIZE, SIZE, yaw=20.0))
        assert calls == ["appearance"]
        calls.clear()
        session.render([Instance(info.id, Controls().set_named({"neck.x": 0.1}))], CAMERA)
        assert sorted(calls) == ["geometry", "mesh"]
        calls.clear()
        session.render([Instance(info.id, Controls().set_named({"jawOpen": 0.1}))], CAMERA)
        assert sorted(calls) == ["geometry", "mesh", "offsets"]


def test_the_cache_stays_within_its_limit(weights, local):
    from grmm_core.session.local import LocalSession
    from grmm_core.session.torch_engine import TorchEngine

    with LocalSession(TorchEngine(weights, "cpu"), cache_bytes=300_000) as small:
        for step in range(12):
            controls = Controls().set_named({"jawOpen": step / 12})
            camera = Camera.orbit(SIZE, SIZE, yaw=5.0 * step)
            tight = small.render([Instance(small.open("default").id, controls)], camera)
            ample = local.render([Instance(local.open("default").id, controls)], camera)
            np.testing.assert_allclose(tight["rgb"], ample["rgb"], atol=1e-5)
            assert small.evaluator.cache.size <= 300_000


def test_plain_and_residual_free_configurations_work(tmp_path):
    from tiny_model import write_tiny_weights

    path = write_tiny_weights(
        tmp_path / "plain.safetensors", mean_maps=False, basis_maps=0, residuals=False, refine=False, features=0
    )
    with create_session("local", weights=path) as session:
        info = session.open("default")
        passes = all_passes(session, [Instance(info.id, Controls().set_named({"jawOpen": 0.5}))])
        assert passes["alpha"].max() > 0.9
        assert passes["features"].shape[-1] == 0
        pair = [Instance(info.id, model_to_world=moved(x)) for x in (-0.1, 0.1)]
        assert all_passes(session, pair)["mask"].shape[-1] == 2


@pytest.mark.parametrize("count", [1, 2])
def test_weights_trained_with_antialiasing_are_drawn_with_it(tmp_path, count):
    """Small Gaussians, so that dilation would count: alone in head space, and beside another head in camera space."""
    import torch
    from tiny_model import write_tiny_weights

    from grmm_core.splat import Gaussians, rasterize

    path = write_tiny_weights(tmp_path / "weights.safetensors", antialias=True, texel_scale=0.15)
    with create_session("local", weights=path) as session:
        avatar = session.open("default").id
        own = session.gaussians(avatar, Controls())
        placed = [Instance(avatar, model_to_world=moved(0.4 * number)) for number in range(count)]
        alpha = session.render(placed, CAMERA, RenderOptions(passes=("alpha",), refine=False))["alpha"][..., 0]
    parts = [torch.as_tensor(part) for part in (own.means, own.quats, own.scales, own.opacities, own.colors)]
    both = [
        Gaussians(parts[0] + torch.tensor([0.4 * number, 0.0, 0.0]), *parts[1:])
        for number in range(count)
    ]  # fmt: skip
    compensated, swollen = (
        rasterize(Gaussians.concatenate(both), CAMERA, antialiased=kept).alpha.numpy() for kept in (True, False)
    )
    np.testing.assert_allclose(alpha, compensated, atol=2e-3)
    assert np.abs(alpha - swollen).max() > 0.05


def test_create_session_asks_for_libraries_where_there_are_none(monkeypatch):
    from grmm_core import session as package

    monkeypatch.setattr(package, "has_torch", lambda: False)
    monkeypatch.setattr(package, "PLAIN_LIBRARIES", ("no_such_library",))
    monkeypatch.delenv(package.WORKER_PYTHON_VARIABLE, raising=False)
    with pytest.raises(RuntimeMissingError, match="choose a Python that has it"):
        create_session()
    with pytest.raises(RuntimeMissingError, match="needs torch, or no_such_library, which this Python does not have"):
        create_session("local")
    with pytest.raises(ConfigError, match="no session mode 'remote'"):
        create_session("remote")


def test_what_is_an_avatars_own_fades_towards_other_people(local, tmp_path):
    """A detail trained for one face stays with small changes of the identity code and is gone at another person's."""
    path = tmp_path / "own.grmm"
    local.save(local.sample(1).id, path)
    plain = local.open(path)
    model = local.target(plain.id).model
    brighter = np.zeros((plain.gaussian_count, 3 + plain.feature_count), np.float32)
    brighter[:, :3] = 0.25
    lower = np.full((plain.gaussian_count, 1), -0.5, np.float32)
    avatar = dataclasses.replace(
        load_avatar(path), deltas={"decoders.appearance_mean": brighter, "decoders.opacity_mean": lower}
    )
    save_avatar(avatar, tmp_path / "changed.grmm")
    changed = local.open(tmp_path / "changed.grmm")
    reach = local.target(changed.id).loaded.reach
    assert 0 < reach < np.inf
    skin = np.ones((plain.gaussian_count, 1), bool)
    skin[on_eyes(model.head_model, model.lit_texels.corners)] = False  # whose colors lie in the shade of lids
    for distance, share in ((0.0, 1.0), (0.25, 0.75), (1.0, 0.0), (3.0, 0.0)):
        controls = Controls(z_id=np.eye(1, model.z_id_size, 2, dtype=np.float32)[0] * reach * distance)
        before, after = (local.gaussians(one.id, controls) for one in (plain, changed))
        free = (after.colors < 1.0) & (before.colors > 0.0) & skin  # neither is at the end of the range
        assert free.mean() > 0.8
        expected = np.broadcast_to(0.25 * share * local.target(plain.id).tones.steady, free.shape)
        np.testing.assert_allclose((after.colors - before.colors)[free], expected[free], atol=1e-5)
        assert np.all(after.opacities < before.opacities) == (share > 0)


def two_frames(local):
    """Two frames of an animation, and their pictures."""
    number = local.open("default").id
    frames = [[Instance(number, Controls().set_named({"jawOpen": value}))] for value in (0.1, 0.6)]
    return frames, [local.render(frame, CAMERA)["rgb"] for frame in frames]


def test_a_picture_that_was_begun_beside_another_is_not_begun_again(local, monkeypatch):
    frames, expected = two_frames(local)
    made, gathered = [], local._gathered
    monkeypatch.setattr(local, "_gathered", lambda instances, *rest: made.append(instances) or gathered(instances, *rest))
    local._set_drawing(True)
    local.begin("second", frames[1], CAMERA, RenderOptions())
    local._set_drawing(False)
    pictures = [local.render(frames[0], CAMERA)["rgb"], local.render(frames[1], CAMERA, begun="second")["rgb"]]
    local.begin("second", frames[1], CAMERA, RenderOptions())  # too late
    assert made == [frames[1], frames[0]]
    for picture, same in zip(pictures, expected, strict=True):
        np.testing.assert_array_equal(picture, same)


def test_a_picture_that_was_drawn_ahead_is_handed_out_once(local, monkeypatch):
    from grmm_core.session import local as module

    frames, expected = two_frames(local)
    drawn, draw = [], module.draw
    monkeypatch.setattr(module, "draw", lambda gathered, *rest: drawn.append(gathered) or draw(gathered, *rest))
    local.draw_ahead()  # nothing is begun
    for ahead in (0, 1):
        local._set_drawing(True)
        local.begin(str(ahead), frames[ahead], CAMERA, RenderOptions())
        local.draw_ahead()
        assert len(drawn) == ahead + 1
        picture = local.render(frames[ahead], CAMERA, begun=str(ahead))["rgb"]
        np.testing.assert_array_equal(picture, expected[ahead])
        assert len(drawn) == ahead + 1
    other = local.render(frames[0], CAMERA, begun="1")["rgb"]  # a second time it is what is asked for that counts
    np.testing.assert_array_equal(other, expected[0])
    assert len(drawn) == 3


def test_of_many_people_drawn_at_random_the_latest_are_held(local):
    from grmm_core.session.wardrobe import READY

    people = [local.sample(seed).id for seed in range(100, 102 + READY)]
    first = local.gaussians(people[0], Controls())
    assert len(set(people)) == READY + 2
    assert len([number for number in local._opened._held if number in people]) == READY
    local.evaluator.cache.clear()
    for number in people[1:]:
        local.target(number)
    again = local.gaussians(people[0], Controls())  # drawn anew from the seed
    np.testing.assert_array_equal(again.means, first.means)
    np.testing.assert_array_equal(again.colors, first.colors)
    assert local.sample(100).id == people[0]
    for number in people:
        local.release(number)
    assert not [number for number in local._opened._held if number in people]


def test_the_faster_engine_draws_where_nobody_chose_one(weights, monkeypatch):
    """On the CPU that is the one without torch; on a graphics card, or where its libraries are missing, torch."""
    from grmm_core import session as package
    from grmm_core.compute import devices

    def name(device="auto", engine="auto"):
        with make_local_session(weights, device, engine=engine) as session:
            return session.status().engine

    assert name("cpu") == "plain"
    assert name("cpu", "torch") == "torch"
    monkeypatch.setattr(devices, "has_card", lambda: False)
    assert name() == "plain"
    monkeypatch.setattr(devices, "has_card", lambda: True)
    assert name() == "torch"
    monkeypatch.setattr(package, "PLAIN_LIBRARIES", ("no_such_library",))
    assert name("cpu") == "torch"
