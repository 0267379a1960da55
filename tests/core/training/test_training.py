from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from model_fixtures import ColoredSpheres, small_head
from PIL import Image
from progress_checks import check_progress

from grmm_core.errors import CancelledError, ConfigError, FileAccessError, FileFormatError, RuntimeMissingError, TrainingError
from grmm_core.jobs.stages import TRAINING
from grmm_core.model.weights import load_weights
from grmm_core.training.checkpoint import load_checkpoint
from grmm_core.training.config import CONFIG_FOLDER, load_config, train_config
from grmm_core.training.losses import OPAQUE, TERMS, LossWeights, total_loss
from grmm_core.training.metric_plots import COLORS, read_metrics, write_curves
from grmm_core.training.metric_plots import main as draw_curves
from grmm_core.training.metrics_log import METRICS
from grmm_core.training.optimise import MovingAverage, rate_factor
from grmm_core.training.processes import mean_terms
from grmm_core.training.trainer import CHECKPOINT, Trainer
from grmm_core.training.views import choose, crop_to_person, random_crop, shrink

QUIET = {"checkpoint_every": 0, "preview_every": 0, "evaluate_every": 0}
LOSSES = {"perceptual": 0.0, "alpha": 0.3, "depth": 0.1, "scale": 0.0}


def config(**settings):
    return train_config({"preset": "tiny"}, {"steps": 40, "warmup_steps": 5, **QUIET, **settings}, LOSSES)


@pytest.fixture(scope="module")
def head():
    return small_head()


@pytest.fixture
def source():
    return ColoredSpheres()


def losses(folder):
    return [json.loads(line)["loss"] for line in (folder / METRICS).read_text().splitlines()]


def test_training_learns_two_people(head, source, tmp_path):
    trainer = Trainer(config(steps=120, refine_from=0.3, evaluate_every=1000), head, source, tmp_path)
    trainer.start()
    before = trainer.evaluate(4)["val_psnr"]
    trainer.run()
    after = trainer.evaluate(4)
    assert after["val_psnr"] > before + 3.0
    assert after["val_psnr"] > 21.0  # the sphere has open poles, which no Gaussian covers
    red, blue = (trainer.cast.draw(source.load(i), None, True).image.detach() for i in (0, 1))
    assert red[24, 24, 0] > red[24, 24, 2] + 0.15
    assert blue[24, 24, 2] > blue[24, 24, 0] + 0.15
    weights = tmp_path / "w.safetensors"
    trainer.save_weights(weights, {"seed": 0}, default_person=1)
    _, info = load_weights(weights, head)
    assert info.people == ("red", "blue")
    np.testing.assert_allclose(info.default_z_id, info.z_id[1])


def test_colors_start_from_the_pictures(head, source, tmp_path):
    trainer = Trainer(config(), head, source, tmp_path)
    trainer.start()
    colors = trainer.model.decoders.appearance_mean[:, :3]
    # the mean of the two people's colors, shaded 0.4 to 1
    np.testing.assert_allclose(colors.mean(0).detach().numpy(), np.array([0.55, 0.4, 0.55]) * 0.7, atol=0.08)


def test_training_without_residuals(head, source, tmp_path):
    plain = train_config({"preset": "tiny", "residuals": False}, {"steps": 3, **QUIET}, {**LOSSES, "code": 0.0})
    trainer = Trainer(plain, head, source, tmp_path)
    trainer.run()
    assert trainer.codes.grad is None
    trainer.save_weights(tmp_path / "w.safetensors", {})
    model, info = load_weights(tmp_path / "w.safetensors", head)
    assert model.aligned_codes is None
    np.testing.assert_array_equal(info.z_id, info.shapes)


def test_resume_repeats_the_run_exactly(head, source, tmp_path):
    settings = {"steps": 12, "refine_from": 0.3, "crop_size": 32, "crop_share": 0.5, "half_until": 0.2, "ema_every": 2}
    whole = Trainer(config(**settings), head, source, tmp_path / "whole")
    whole.run()
    first = Trainer(config(**settings), head, source, tmp_path / "parts")
    with pytest.raises(CancelledError):
        first.run(cancelled=lambda: first.step_count == 5)
    second = Trainer(config(**settings), head, source, tmp_path / "parts")
    assert second.resume()
    assert second.step_count == 5
    second.run()
    assert losses(tmp_path / "parts") == losses(tmp_path / "whole")
    for name, value in whole.parameters.items():
        torch.testing.assert_close(second.parameters[name], value, rtol=0, atol=0)
    for one, two in zip(whole.average.values, second.average.values, strict=True):
        torch.testing.assert_close(one, two, rtol=0, atol=0)


def test_settings_that_differ_are_named(head, source, tmp_path):
    first = Trainer(config(tensorboard=False), head, source, tmp_path)
    first.step()
    first.save()
    same = Trainer(config(minutes=3.0, threads=1, preview_every=7), head, source, tmp_path)
    assert same.resume()
    assert same.differences == []
    source.training = source.training[:6]
    losses_then = {**LOSSES, "depth": 0.2, "l1": 0.8}  # 0.8 is the default
    changed = train_config({"preset": "tiny"}, {"steps": 50, "warmup_steps": 5, **QUIET}, losses_then)
    other = Trainer(changed, head, source, tmp_path)
    assert other.resume()
    assert other.differences == [
        "steps 50 instead of 40", "depth 0.2 instead of 0.1", "6 training views instead of 8, in another order",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "device", ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"))]
)
def test_the_optimiser_is_restored_where_it_was(head, source, tmp_path, device):
    first = Trainer(config(), head, source, tmp_path, device, "torch" if device == "cpu" else "auto")
    first.step()
    first.save()
    second = Trainer(config(), head, source, tmp_path, device, "torch" if device == "cpu" else "auto")
    assert second.resume()
    for name, parameter in first.parameters.items():
        expected, found = first.optimiser.state[parameter], second.optimiser.state[second.parameters[name]]
        assert expected.keys() == found.keys()
        for key, value in expected.items():
            assert (found[key].device, found[key].dtype, found[key].shape) == (value.device, value.dtype, value.shape)
            assert torch.equal(found[key], value)
    second.step()


def test_two_views_average_their_gradients(head, source, tmp_path):
    pair = Trainer(config(views_per_step=2, clip_norm=0.0), head, source, tmp_path)
    pair.start()
    views = [choose(pair.config, source, 0, place, 0.0) for place in (0, 1)]
    assert views[0][0].name != views[1][0].name
    expected = None
    for view, background in views:
        pair.optimiser.zero_grad(set_to_none=True)
        rendering, target = pair.cast.draw(view, background, True), pair.cast.target(view, background)
        total_loss(rendering, target, pair.laplacian, pair.loss_weights)[0].backward()
        gradient = pair.model.decoders.appearance_mean.grad.clone()
        expected = gradient / 2 if expected is None else expected + gradient / 2
    pair.step()
    torch.testing.assert_close(pair.model.decoders.appearance_mean.grad, expected, atol=1e-7, rtol=1e-4)


def test_vertices_colors_and_opacities_are_held_to_the_truth(head, source, tmp_path):
    pair = Trainer(config(clip_norm=0.0), head, source, tmp_path)
    pair.start()
    view, background = choose(pair.config, source, 0, 0, 0.0)
    moved = np.random.default_rng(0).normal(0, 1e-3, head.v_template.shape).astype(np.float32)
    view = replace(view, displacement=moved)
    with torch.no_grad():
        pair.model.decoders.appearance_mean[:5, :3] = 2.0
        pair.model.decoders.opacity_mean[7] = -50.0
    rendering, target = pair.cast.draw(view, background, True), pair.cast.target(view, background)
    weights = LossWeights(vertices=1.0, color=1.0, opacity=1.0, detail=2.0)
    target.detail = torch.zeros(target.image.shape[:2])
    target.detail[3:9, 4:7] = 0.5
    terms = total_loss(rendering, target, pair.laplacian, weights)[1]
    plain = pair.model.vertices(*(torch.as_tensor(a) for a in (source.shapes[view.subject], view.expression, view.pose)))
    apart = (rendering.mesh.vertices - plain).detach().numpy() - moved
    assert float(terms["vertices"]) == pytest.approx((apart**2).sum(1).mean() * 1e6, rel=1e-3)
    colors = rendering.gaussians.colors.detach().numpy()
    assert float(terms["color"]) == pytest.approx(((colors - colors.clip(0, 1)) ** 2).mean(), rel=1e-4)
    assert float(terms["color"]) > 0
    lacking = (OPAQUE - rendering.gaussians.opacities.detach().numpy()).clip(0)
    assert lacking[7] == pytest.approx(OPAQUE)
    assert float(terms["opacity"]) == pytest.approx(lacking.mean(), rel=1e-4)
    for name, picture in (("raw_detail", rendering.raw), ("image_detail", rendering.image)):
        wrong = (picture - target.image).detach().abs()[3:9, 4:7].sum() * 0.5 / target.image.numel()
        assert float(terms[name]) == pytest.approx(float(wrong), rel=1e-4)


def test_a_crop_is_refined_by_the_depths_of_its_whole_picture(head, source, tmp_path):
    settings = {"crop_size": 24, "crop_share": 1.0, "margin": 4}
    pair = Trainer(config(**settings), head, source, tmp_path)
    view, _ = choose(pair.config, source, 0, 0, 1.0)
    whole, _ = choose(config(), source, 0, 0, 1.0)
    covered = whole.depth[whole.depth > 0]
    assert view.image.shape != whole.image.shape
    assert view.depths == pytest.approx((covered.min(), covered.max()), abs=1e-6)
    with torch.no_grad():
        pair.model.refinement.exit.weight.normal_(0, 0.1, generator=torch.Generator().manual_seed(0))
        drawn, alone = (pair.cast.draw(v, np.zeros(3), True).image for v in (view, replace(view, depths=None)))
    assert (drawn - alone).abs().max() > 1e-4


def test_offsets_have_a_rate_of_their_own(head, source, tmp_path):
    trainer = Trainer(config(lr_offsets=1e-4, lr_maps=2e-3), head, source, tmp_path)
    rates = {id(parameter): group["peak"] for group in trainer.optimiser.param_groups for parameter in group["params"]}
    decoders = trainer.model.decoders
    assert [rates[id(p)] for p in (decoders.transform_mean, decoders.basis["position"])] == [1e-4, 1e-4]
    assert [rates[id(p)] for p in (decoders.appearance_mean, decoders.basis["colour"])] == [2e-3, 2e-3]


def test_a_loss_that_is_not_finite_keeps_the_checkpoint(head, source, tmp_path):
    trainer = Trainer(config(checkpoint_every=2), head, source, tmp_path)
    trainer.start()
    trainer.step()
    trainer.save()
    kept = (tmp_path / CHECKPOINT).read_bytes()
    with torch.no_grad():
        trainer.model.decoders.appearance_mean.fill_(torch.nan)
        # non-finite Gaussians are not drawn, so the raw loss stays finite; the offsets' terms do not
        trainer.model.mesh_decoder.identity[-1].bias.fill_(torch.nan)
    with pytest.raises(TrainingError, match="--resume"):
        trainer.run()
    assert (tmp_path / CHECKPOINT).read_bytes() == kept
    (tmp_path / CHECKPOINT).unlink()
    with pytest.raises(TrainingError, match="start again"):
        trainer.run()


@pytest.mark.parametrize("clip_norm", [0.0, 1.0])
def test_gradients_that_are_not_finite_keep_checkpoint_and_weights(head, source, tmp_path, clip_norm):
    trainer = Trainer(config(checkpoint_every=1, clip_norm=clip_norm), head, source, tmp_path)
    with pytest.raises(CancelledError):
        trainer.run(cancelled=lambda: True)
    kept = (tmp_path / CHECKPOINT).read_bytes()
    weights = {name: value.detach().clone() for name, value in trainer.parameters.items()}
    trainer.codes.register_hook(lambda gradient: gradient * torch.nan)
    with pytest.raises(TrainingError, match="gradient is not finite at step 1"):
        trainer.run()
    assert (tmp_path / CHECKPOINT).read_bytes() == kept
    assert all(torch.equal(trainer.parameters[name], value) for name, value in weights.items())


def test_the_numbers_of_a_step_are_means_over_its_views(head, source, tmp_path):
    pair = Trainer(config(views_per_step=2, clip_norm=0.0), head, source, tmp_path)
    pair.start()
    singles = []
    for view, background in (choose(pair.config, source, 0, place, 0.0) for place in (0, 1)):
        rendering, target = pair.cast.draw(view, background, True), pair.cast.target(view, background)
        loss, terms = total_loss(rendering, target, pair.laplacian, pair.loss_weights)
        singles.append({"loss": float(loss.detach()), **{name: float(value) for name, value in terms.items()}})
    numbers = pair.step()
    assert set(singles[0]) - {"loss"} <= set(TERMS)
    for name, value in singles[0].items():
        assert numbers[name] == pytest.approx((value + singles[1][name]) / 2, rel=1e-5)
    assert numbers["gradient_norm"] > 0
    assert mean_terms([{"loss": 1.0, "depth": 3.0}, {"loss": 2.0}], ("loss", "depth", "alpha"), torch.device("cpu")) == {
        "loss": 1.5, "depth": 3.0,
    }  # fmt: skip


def test_damaged_and_foreign_checkpoints_are_refused(head, source, tmp_path):
    trainer = Trainer(config(), head, source, tmp_path)
    assert not trainer.resume()
    trainer.step()
    trainer.save()
    path = tmp_path / CHECKPOINT
    strangers = ColoredSpheres()
    strangers.people = ("red", "green")
    with pytest.raises(ConfigError, match="people"):
        Trainer(config(), head, strangers, tmp_path).resume()
    larger = Trainer(train_config({"preset": "tiny", "z_exp": 7}, QUIET, LOSSES), head, source, tmp_path)
    with pytest.raises(ConfigError, match="z_exp 7 instead of 5"):
        larger.resume()
    averages = dict(zip(larger.parameters, larger.average.values, strict=True))
    with pytest.raises(FileFormatError, match="fit"):  # a checkpoint whose tensors are not what its settings say
        load_checkpoint(path, larger.parameters, larger.optimiser, averages)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FileFormatError):
        Trainer(config(), head, source, tmp_path).resume()


def test_unusable_folder_and_empty_data_are_explained(head, source, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileAccessError):
        Trainer(config(), head, source, tmp_path / "file" / "run")
    source.training = source.training[:0]
    with pytest.raises(TrainingError, match="no training views"):
        Trainer(config(), head, source, tmp_path)


def forget(trainer):
    """Let the next step fail."""
    with torch.no_grad():
        trainer.model.mesh_decoder.identity[-1].bias.fill_(torch.nan)


def scalars(folder, name):
    """Steps of a TensorBoard curve."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder))
    events.Reload()
    return [event.step for event in events.Scalars(name)]


def test_curves_for_tensorboard(head, source, tmp_path, monkeypatch):
    trainer = Trainer(config(tensorboard=True, steps=4, checkpoint_every=2), head, source, tmp_path)
    with pytest.raises(TrainingError):
        trainer.run(lambda _: forget(trainer) if trainer.step_count == 3 else None)
    second = Trainer(config(tensorboard=True, steps=4), head, source, tmp_path)
    assert second.resume()
    second.run()
    assert second.log.writer is None  # closed
    assert scalars(tmp_path, "loss") == [1, 2, 3, 4]
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)  # not installed, or without what it needs
    with pytest.raises(RuntimeMissingError, match="pip install tensorboard"):
        Trainer(config(tensorboard=True), head, source, tmp_path)


def test_preview_is_a_picture(head, source, tmp_path):
    trainer = Trainer(config(steps=3, preview_every=1), head, source, tmp_path)
    seen = []
    trainer.run(seen.append)
    check_progress(seen, TRAINING)
    assert [one.stage for one in seen] == ["prepare", "steps", "steps", "steps"]
    assert seen[-1].fraction == 1.0
    assert seen[-1].message == f"step 3 loss {trainer.metrics['loss']:.4f}"
    assert seen[-1].picture == str(tmp_path / "preview_000002.png")  # the newest when the last step was done
    picture = np.asarray(Image.open(tmp_path / "preview_000001.png"))
    assert picture.shape == (5 * 48, 4 * 48, 3)
    assert picture.std() > 10


def test_curves_are_drawn_of_what_was_logged(head, source, tmp_path):
    Trainer(config(steps=3, preview_every=3, evaluate_every=1), head, source, tmp_path).run()
    drawn = np.asarray(Image.open(tmp_path / "curves.png"))
    for panel in np.split(drawn, 2):  # the loss above, held-out views below; the first line of both has the first color
        assert (panel == COLORS[0]).all(-1).sum() > 200
    rows = read_metrics(tmp_path / "metrics.jsonl")
    write_curves([rows, rows], tmp_path / "two.png")
    assert (np.asarray(Image.open(tmp_path / "two.png")) != drawn).any()
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\n')
    with pytest.raises(FileFormatError, match=r"metrics\.jsonl"):
        read_metrics(tmp_path / "metrics.jsonl")
    (tmp_path / "metrics.jsonl").write_text("")
    with pytest.raises(FileFormatError, match="no steps"):
        read_metrics(tmp_path / "metrics.jsonl")


def test_curves_of_a_missing_file_are_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["curves", str(tmp_path / "missing.jsonl"), "-o", str(tmp_path / "c.png")])
    with pytest.raises(SystemExit, match=r"missing\.jsonl does not exist") as stop:
        draw_curves()
    assert stop.value.__cause__ is None


def test_every_view_is_used_once_an_epoch(source):
    c = config()
    names = [choose(c, source, step, 0, 0.0)[0].name for step in range(16)]
    assert sorted(names[:8]) == sorted(names[8:]) == sorted(f"view {i}" for i in range(8))
    assert names[:8] != names[8:]
    assert choose(c, source, 3, 0, 0.0)[1].tolist() == choose(c, source, 3, 0, 0.0)[1].tolist()


def test_shrinking_and_cropping_keep_camera_and_pixels_in_step(source):
    view = source.load(5)
    point = np.array([0.01, 0.02, 0.09])

    def pixel(camera):
        x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
        return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])

    small = shrink(view, 24)
    assert small.image.shape == (24, 24, 3)
    np.testing.assert_allclose(pixel(small.camera) * 2, pixel(view.camera), atol=1e-9)
    np.testing.assert_allclose(small.image[5, 7], view.image[10:12, 14:16].mean((0, 1)), atol=0.51)
    crop = random_crop(view, 16, np.random.default_rng(0))
    x, y = np.round(pixel(view.camera) - pixel(crop.camera)).astype(int)
    np.testing.assert_array_equal(crop.image, view.image[y : y + 16, x : x + 16])
    view = ColoredSpheres(96).load(5)
    person = crop_to_person(view, 3)
    x, y = np.round(pixel(view.camera) - pixel(person.camera)).astype(int)
    assert person.mask.sum() == view.mask.sum()
    assert person.mask.shape == (80, 80)
    np.testing.assert_array_equal(person.image, view.image[y : y + person.mask.shape[0], x : x + person.mask.shape[1]])
    assert shrink(view, 100) is view
    assert random_crop(view, 128, np.random.default_rng(0)) is view


def test_moving_average_and_rates():
    p = torch.nn.Parameter(torch.zeros(3))
    average = MovingAverage([p], 0.9, 2)
    with torch.no_grad():
        p.fill_(1.0)
    average.update(1)
    assert float(average.values[0][0]) == 0.0
    for step in range(2, 200, 2):
        average.update(step)
    assert float(average.values[0][0]) == pytest.approx(1.0, abs=1e-4)
    with average.swapped(), torch.no_grad():
        p.mul_(5)
    assert float(p[0]) == 1.0
    c = config(warmup_steps=10)
    assert rate_factor(c, 0, 0.0) == pytest.approx(0.1)
    assert rate_factor(c, 100, 0.5) == pytest.approx(0.51)
    assert rate_factor(c, 100, 1.0) == pytest.approx(0.02)


@pytest.mark.parametrize("path", sorted(CONFIG_FOLDER.glob("*.toml")), ids=lambda p: p.stem)
def test_the_projects_configurations_load(path):
    assert load_config(path.stem).model.name in ("small", "paper", "base")


def test_a_name_that_is_no_configuration_gets_the_known_ones():
    with pytest.raises(FileAccessError, match=r"'smal'.*paper, person, regions, small, small_no_residuals"):
        load_config("smal")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[training]\nstep = 3", "step"),
        ("[training]\nsteps = 1.5", "steps"),
        ("[training]\nema = 2.0", "ema"),
        ("[model]\npreset = 'huge'", "huge"),
        ("[other]\nx = 1", "other"),
        ("steps = 3", "outside"),
        ("[training", "TOML"),
    ],
)
def test_bad_configurations_are_named(tmp_path, text, word):
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=word):
        load_config(path)
