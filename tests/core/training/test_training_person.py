"""Training for one captured person: only that person's maps change, and the avatar draws what was trained."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from model_fixtures import SHAPES, TEETH, ColoredSpheres, small_head, train_spheres

from grmm_core.errors import ConfigError, FileFormatError
from grmm_core.model.torch_loader import with_deltas
from grmm_core.model.weights import load_weights
from grmm_core.training.config import train_config
from grmm_core.training.personal import APPEARANCE, OWN_MAPS, flesh_tones, in_the_mouth
from grmm_core.training.trainer import CHECKPOINT, Trainer

QUIET = {"checkpoint_every": 0, "preview_every": 0, "evaluate_every": 0}


class RedSphere(ColoredSpheres):
    """Views of the first person alone."""

    def __init__(self, name="red"):
        super().__init__()
        self.people = (name,)
        self.shapes = np.zeros((1, SHAPES), np.float32)
        self.training, self.validation = self.training[::2], self.validation[::2]


def config(**settings):
    model = {} if "person" in settings else {"preset": "tiny"}  # one person's run takes the sizes of the weights
    return train_config(model, {"warmup_steps": 2, "lr_maps": 0.02, **QUIET, **settings}, {"perceptual": 0.0})


@pytest.fixture(scope="module")
def head():
    return small_head()


@pytest.fixture(scope="module")
def folder(head, tmp_path_factory):
    """Briefly trained weights of both people, and a checkpoint of them."""
    return train_spheres(config(steps=30, ema=0.5), head, tmp_path_factory.mktemp("trained")).folder


def run(folder, head, target, **settings):
    settings = {"person": "red", "init_from": str(folder / "w.safetensors"), "steps": 40, "ema": 0.5, **settings}
    trainer = Trainer(config(**settings), head, RedSphere(), target)
    trainer.run()
    return trainer


def test_the_person_gets_better_and_the_shared_parts_stay(folder, head, tmp_path):
    before, info = load_weights(folder / "w.safetensors", head)
    trainer = run(folder, head, tmp_path)
    untrained = Trainer(trainer.config, head, RedSphere(), tmp_path / "untrained")
    assert trainer.evaluate(4)["val_psnr"] > untrained.evaluate(4)["val_psnr"] + 1.0
    kept = dict(before.named_parameters())
    changed = {n for n, p in trainer.model.named_parameters() if not torch.equal(p.detach(), kept[n].detach())}
    assert changed == set(trainer.parameters) == {name for name in kept if name in OWN_MAPS}
    assert torch.equal(trainer.codes[0], torch.from_numpy(info.z_id[info.people.index("red")]))


def test_the_avatar_draws_what_was_trained(folder, head, tmp_path):
    trainer = run(folder, head, tmp_path)
    avatar = trainer.person_avatar("Red", "CC0-1.0")
    with trainer.averaged():
        own = {name: value.detach().clone() for name, value in trainer.parameters.items()}
    model, info = load_weights(folder / "w.safetensors", head)
    plain = dict(model.named_parameters())
    mouth = in_the_mouth(model)
    tones = flesh_tones(model, trainer.codes[0].detach())
    changed = with_deltas(model, avatar.deltas, tmp_path)
    for name, value in changed.named_parameters():
        if name in own:
            expected = torch.where(mouth[:, None], plain[name].detach(), own[name])  # a mouth stays that of the weights
            if name == APPEARANCE:
                expected[:, :3] += torch.where(mouth[:, None], tones, 0.0)
            step = np.abs(avatar.deltas[name]).max() / 127  # of eight bits
            torch.testing.assert_close(value.detach(), expected, rtol=0, atol=float(step) + 1e-6)
    assert (avatar.name, avatar.weights.sha256, avatar.provenance.licence) == ("Red", info.sha256, "CC0-1.0")
    assert not avatar.provenance.from_photos


def test_nothing_in_the_mouth_is_greener_than_red(folder, head):
    model, info = load_weights(folder / "w.safetensors", head)
    z_id = torch.from_numpy(info.z_id[0])
    teeth = torch.from_numpy(np.isin(head.faces[model.anchor.face.numpy()], TEETH).any(1))
    assert 0 < teeth.sum() < len(teeth)
    with torch.no_grad():
        model.decoders.appearance_mean[:, :3] += torch.tensor([-0.6, 0.3, 0.0])
        changes = flesh_tones(model, z_id)
        colors = model.appearance(z_id, torch.tensor([0.0, 0.0, 1.0]))[0]
    assert (changes[~teeth] == 0).all()
    after = (colors + changes)[teeth]
    assert (after[:, 1:] <= after[:, :1] + 1e-6).all()
    torch.testing.assert_close(after[:, 0], colors[teeth, 0], rtol=0, atol=0)


def test_a_killed_run_goes_on(folder, head, tmp_path):
    whole = run(folder, head, tmp_path / "whole", steps=12)
    half = Trainer(whole.config, head, RedSphere(), tmp_path / "half")
    for _ in range(6):
        half.step()
    half.save()
    rest = Trainer(whole.config, head, RedSphere(), tmp_path / "half")
    assert rest.resume()
    rest.run()
    for name, value in whole.parameters.items():
        torch.testing.assert_close(rest.parameters[name], value, rtol=1e-4, atol=1e-6)


def test_what_cannot_be_trained_is_said_first(folder, head, tmp_path):
    def begin(person, source, init_from):
        Trainer(config(person=person, init_from=init_from), head, source, tmp_path / "run")

    weights = str(folder / "w.safetensors")
    with pytest.raises(ConfigError, match=r"no training views of 'green'.*red"):
        begin("green", RedSphere(), weights)
    with pytest.raises(ConfigError, match=r"do not know 'green'.*blue, red"):
        begin("green", RedSphere("green"), weights)
    with pytest.raises(FileFormatError):
        begin("red", RedSphere(), str(folder / CHECKPOINT))
    with pytest.raises(ConfigError, match="init_from"):
        begin("red", RedSphere(), "")
    with pytest.raises(ConfigError, match="many people"):
        Trainer(config(), head, ColoredSpheres(), tmp_path / "all").person_avatar("Red")
