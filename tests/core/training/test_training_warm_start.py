"""A run that starts from the networks of another one, with other people."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from model_fixtures import SHAPES, ColoredSpheres, small_head, train_spheres
from model_fixtures import quiet_config as config

from grmm_core.errors import ConfigError, FileAccessError, FileFormatError
from grmm_core.files.tensorfile import write_tensors
from grmm_core.model.config import BASIS_COLOR
from grmm_core.training.trainer import CHECKPOINT, Trainer


class ThreeSpheres(ColoredSpheres):
    def __init__(self):
        super().__init__()
        self.people = ("x", "y", "z")
        self.shapes = np.zeros((3, SHAPES), np.float32)


@pytest.fixture(scope="module")
def head():
    return small_head()


@pytest.fixture(scope="module")
def trained(head, tmp_path_factory):
    return train_spheres(config(steps=60, ema=0.5), head, tmp_path_factory.mktemp("trained"))


@pytest.mark.parametrize(("name", "tolerance"), [(CHECKPOINT, 0.0), ("w.safetensors", 2e-3)])
def test_networks_are_taken_and_people_are_new(head, trained, tmp_path, name, tolerance):
    cold = Trainer(config(), head, ThreeSpheres(), tmp_path / "cold")
    warm = Trainer(config(init_from=str(trained.folder / name)), head, ThreeSpheres(), tmp_path / "warm")
    before = warm.codes.detach().clone()
    warm.start()
    with trained.averaged():
        for key, value in trained.model.named_parameters():
            torch.testing.assert_close(warm.parameters[key], value, rtol=tolerance, atol=tolerance)
        mean = trained.codes.detach().mean(0)
    assert warm.codes.shape == (3, 6)
    torch.testing.assert_close(warm.codes, before + mean, rtol=0, atol=1e-5)
    for one, parameter in zip(warm.average.values, warm.average.parameters, strict=True):
        torch.testing.assert_close(one, parameter.detach(), rtol=0, atol=0)
    cold.start()
    assert warm.step()["loss"] < 0.8 * cold.step()["loss"]


def test_a_model_with_more_basis_maps_keeps_the_trained_ones(head, trained, tmp_path):
    path = str(trained.folder / CHECKPOINT)
    warm = Trainer(config({"basis_maps": 5}, init_from=path), head, ThreeSpheres(), tmp_path / "more")
    fresh = warm.model.decoders.basis[BASIS_COLOR].detach().clone()
    warm.start()
    basis = warm.model.decoders.basis[BASIS_COLOR].detach()
    with trained.averaged():
        torch.testing.assert_close(basis[:3], trained.model.decoders.basis[BASIS_COLOR].detach(), rtol=0, atol=0)
    torch.testing.assert_close(basis[3:], fresh[3:], rtol=0, atol=0)
    with pytest.raises(ConfigError, match="does not fit"):
        Trainer(config({"basis_maps": 2}, init_from=path), head, ThreeSpheres(), tmp_path / "fewer").start()


def test_people_of_the_same_names_keep_their_codes(head, trained, tmp_path):
    class OneKnown(ThreeSpheres):
        def __init__(self):
            super().__init__()
            self.people = ("x", ColoredSpheres().people[1], "z")

    warm = Trainer(config(init_from=str(trained.folder / CHECKPOINT)), head, OneKnown(), tmp_path / "known")
    before = warm.codes.detach().clone()
    warm.start()
    with trained.averaged():
        codes = trained.codes.detach().clone()
    torch.testing.assert_close(warm.codes[1], codes[1], rtol=0, atol=0)
    torch.testing.assert_close(warm.codes[0], before[0] + codes.mean(0), rtol=0, atol=1e-5)


def test_expression_maps_may_be_added(head, trained, tmp_path):
    plain = Trainer(config({"expression_maps": 0}, steps=2), head, ColoredSpheres(), tmp_path / "plain")
    plain.run()
    plain.save()
    warm = Trainer(config(init_from=str(plain.folder / CHECKPOINT)), head, ColoredSpheres(), tmp_path / "with")
    warm.start()
    assert not warm.model.decoders.expression.maps.any()
    with plain.averaged():
        torch.testing.assert_close(warm.model.decoders.appearance_mean, plain.model.decoders.appearance_mean, rtol=0, atol=0)


def test_there_may_be_more_expression_maps_than_before(head, trained, tmp_path):
    warm = Trainer(config({"expression_maps": 5}, init_from=str(trained.folder / CHECKPOINT)), head, ColoredSpheres(), tmp_path)
    warm.start()
    own, before = warm.model.decoders.expression, trained.model.decoders.expression
    assert len(before.maps) < len(own.maps) == 5
    with trained.averaged():
        torch.testing.assert_close(own.maps[: len(before.maps)], before.maps, rtol=0, atol=0)
    assert not own.maps[len(before.maps) :].any()


def test_a_resumed_run_keeps_its_own_state(head, trained, tmp_path):
    settings = {"init_from": str(trained.folder / CHECKPOINT), "steps": 3}
    first = Trainer(config(**settings), head, ThreeSpheres(), tmp_path)
    first.run()
    second = Trainer(config(**settings), head, ThreeSpheres(), tmp_path)
    assert second.resume()
    second.start()
    torch.testing.assert_close(second.codes, first.codes, rtol=0, atol=0)


def test_files_that_do_not_fit_are_explained(head, trained, tmp_path):
    def start(path, model=None):
        Trainer(config(model, init_from=str(path)), head, ThreeSpheres(), tmp_path / "run").start()

    with pytest.raises(ConfigError, match=r"z_exp|codes|mesh_decoder|decoders"):
        start(trained.folder / CHECKPOINT, {"z_exp": 7})
    with pytest.raises(ConfigError, match=r"w\.safetensors does not fit"):
        start(trained.folder / "w.safetensors", {"z_exp": 7})
    with pytest.raises(FileAccessError, match="does not exist"):
        start(tmp_path / "none.safetensors")
    write_tensors(tmp_path / "other.safetensors", {"x": np.zeros(3, np.float32)}, {"grmm": '{"format": "other"}'})
    with pytest.raises(FileFormatError):
        start(tmp_path / "other.safetensors")
