"""A run that trains what expressions change and leaves faces at rest as they are."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from model_fixtures import SHAPES, ColoredSpheres, small_head, train_spheres
from model_fixtures import quiet_config as config

from grmm_core.errors import ConfigError
from grmm_core.model.weights import load_weights
from grmm_core.training.config import load_config
from grmm_core.training.trainer import Trainer


class OneStranger(ColoredSpheres):
    """The people of the weights and one whom they do not know."""

    def __init__(self):
        super().__init__()
        self.people = ("stranger", *self.people)
        self.shapes = np.zeros((3, SHAPES), np.float32)
        self.subjects = self.subjects + 1
        self.subjects[:2] = 0


@pytest.fixture(scope="module")
def head():
    return small_head()


@pytest.fixture(scope="module")
def trained(head, tmp_path_factory):
    run = train_spheres(config(steps=20, ema=0.5), head, tmp_path_factory.mktemp("trained"))
    return run.folder / "w.safetensors"


@pytest.fixture(scope="module")
def continued(head, trained, tmp_path_factory):
    settings = config(
        {"expression_maps": 4}, steps=6, expressions=True, init_from=str(trained), lr_maps=0.1, ema=0.0, name="more"
    )
    run = Trainer(settings, head, OneStranger(), tmp_path_factory.mktemp("continued"))
    run.run()
    run.save_weights(run.folder / "more.safetensors", {"note": "six steps"})
    return run


def decoded(path, head, aligned):
    """Offsets, opacities and colors of the first person with an expression."""
    model, info = load_weights(path, head)
    z_id = torch.from_numpy(info.z_id[0])
    z_exp = model.z_expression(torch.full((len(model.aligned_codes),), aligned))
    with torch.no_grad():
        colors = model.appearance(z_id, torch.tensor([0.0, 0.0, 1.0]))[0] + model.expression_colors(z_id, z_exp)
        return model.offsets(z_id, z_exp), model.opacity(z_id), colors


def test_faces_at_rest_stay_and_expressions_change(head, trained, continued):
    new = continued.folder / "more.safetensors"
    for before, after in zip(decoded(trained, head, 0.0), decoded(new, head, 0.0), strict=True):
        torch.testing.assert_close(after, before, rtol=0, atol=0)
    before, after = decoded(trained, head, 0.5), decoded(new, head, 0.5)
    assert (before[0] - after[0]).abs().max() > 1e-4
    assert (before[2] - after[2]).abs().max() > 1e-4


def test_the_file_says_whom_it_draws(head, trained, continued):
    old, new = (load_weights(path, head)[1] for path in (trained, continued.folder / "more.safetensors"))
    assert new.name == "more"
    assert new.people == old.people
    np.testing.assert_array_equal(new.z_id, old.z_id)
    assert new.draws(old.sha256)
    assert new.draws(new.sha256)
    assert not new.draws("")
    assert not new.draws("f" * 64)
    assert not old.draws(new.sha256)
    assert new.provenance["note"] == "six steps"


def test_people_whom_the_weights_do_not_know_are_left_out(continued):
    source = continued.source
    assert 0 not in source.subjects[source.training]
    assert len(source.training) == 6


def test_it_can_be_stopped_and_resumed(head, continued):
    again = Trainer(continued.config, head, OneStranger(), continued.folder)
    continued.save()
    assert again.resume()
    assert again.step_count == 6
    for name, value in continued.model.named_parameters():
        torch.testing.assert_close(dict(again.model.named_parameters())[name], value, rtol=0, atol=3e-3)


def test_what_cannot_be_continued_is_explained(head, trained, tmp_path):
    class Strangers(OneStranger):
        def __init__(self):
            super().__init__()
            self.people = ("a", "b", "c")

    with pytest.raises(ConfigError, match="know nobody of this data"):
        Trainer(config(expressions=True, init_from=str(trained)), head, Strangers(), tmp_path)
    with pytest.raises(ConfigError, match="starts from weights and is for all"):
        config(expressions=True)
    with pytest.raises(ConfigError, match="cannot follow a capture"):
        config(expressions=True, init_from=str(trained), refresh_every=5)
    assert load_config("expressions").expressions
