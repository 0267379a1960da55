"""A run that trains what lies in some regions of the head and leaves every other Gaussian as it is."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from model_fixtures import ColoredSpheres, small_head, train_spheres
from model_fixtures import quiet_config as config

from grmm_core.errors import ConfigError
from grmm_core.model.grmm import GRMM
from grmm_core.model.layout import TexelLayout
from grmm_core.model.renewed import carried_over
from grmm_core.model.weights import load_weights, save_weights
from grmm_core.training.config import load_config
from grmm_core.training.trainer import Trainer

REGION = "upper_teeth"


@pytest.fixture(scope="module")
def head():
    return small_head()


@pytest.fixture(scope="module")
def trained(head, tmp_path_factory):
    run = train_spheres(config(steps=20, ema=0.5), head, tmp_path_factory.mktemp("trained"))
    return run.folder / "w.safetensors"


def renewed(head, start, folder, regions=REGION):
    """Weights after six steps on regions."""
    settings = config(steps=6, regions=regions, init_from=str(start), lr_maps=0.1, lr_offsets=0.1, ema=0.0, name="more")
    run = Trainer(settings, head, ColoredSpheres(), folder)
    run.run()
    run.save_weights(folder / "more.safetensors", {})
    return folder / "more.safetensors"


@pytest.fixture(scope="module")
def anew(head, trained, tmp_path_factory):
    return renewed(head, trained, tmp_path_factory.mktemp("anew"))


def decoded(path, head):
    """Offsets [N, 10], opacities [N, 1] and colors [N, 3] of the first person with an expression; and the layout."""
    model, info = load_weights(path, head)
    z_id = torch.from_numpy(info.z_id[0])
    z_exp = model.z_expression(torch.full((len(model.aligned_codes),), 0.4))
    with torch.no_grad():
        colors = model.appearance(z_id, torch.tensor([0.0, 0.0, 1.0]))[0] + model.expression_colors(z_id, z_exp)
        return (model.offsets(z_id, z_exp), model.opacity(z_id)[:, None], colors), model.layout


def test_only_the_region_changes(head, trained, anew):
    (before, layout), (after, _) = decoded(trained, head), decoded(anew, head)
    inside = torch.from_numpy(layout.within(head, REGION))
    assert 0 < inside.sum() < len(inside)
    for old, new in zip(before, after, strict=True):
        # the file rounds basis maps in blocks, and a block may hold Gaussians of both sides
        torch.testing.assert_close(new[~inside], old[~inside], rtol=0, atol=2e-4)
        assert (new[~inside] == old[~inside]).all(1).float().mean() > 0.6
    assert (after[2] - before[2])[inside].abs().max() > 0.01


def test_new_weights_say_what_was_trained_anew_since_which(head, trained, anew, tmp_path):
    old, new = load_weights(trained, head)[1], load_weights(anew, head)[1]
    assert new.draws(old.sha256)
    assert new.renewed_since(old.sha256) == (REGION,)
    assert new.renewed_since(new.sha256) == ()
    third = load_weights(renewed(head, anew, tmp_path, "lower_teeth"), head)[1]
    assert third.renewed_since(old.sha256) == ("lower_teeth", REGION)
    assert third.renewed_since(new.sha256) == ("lower_teeth",)


def test_avatars_keep_the_tone_of_their_changes_there_and_the_rest_as_it_is(head, trained, anew):
    old, (model, new) = load_weights(trained, head)[1], load_weights(anew, head)
    layout = model.layout
    inside = layout.within(head, REGION)
    rng = np.random.default_rng(4)
    changes = rng.normal(0, 1, (len(layout), 3)).astype(np.float32)
    deltas = {"decoders.appearance_mean": changes, "decoders.basis_weights.weight": np.ones((2, 3), np.float32)}
    kept = carried_over(deltas, old.sha256, new, layout, head)
    np.testing.assert_array_equal(kept["decoders.appearance_mean"][~inside], changes[~inside])
    np.testing.assert_array_equal(
        kept["decoders.appearance_mean"][inside], np.broadcast_to(np.median(changes[inside], 0), (inside.sum(), 3))
    )
    np.testing.assert_array_equal(kept["decoders.basis_weights.weight"], 1.0)
    same = carried_over(deltas, new.sha256, new, layout, head)
    np.testing.assert_array_equal(same["decoders.appearance_mean"], changes)


def test_a_run_that_was_stopped_goes_on(head, trained, tmp_path):
    settings = config(steps=6, regions=REGION, init_from=str(trained), ema=0.0)
    run = Trainer(settings, head, ColoredSpheres(), tmp_path)
    run.run()
    again = Trainer(settings, head, ColoredSpheres(), tmp_path)
    assert again.resume()
    for name, value in run.model.named_parameters():
        torch.testing.assert_close(dict(again.model.named_parameters())[name], value, rtol=0, atol=0)


def test_what_cannot_be_trained_is_explained(head, trained, tmp_path):
    with pytest.raises(ConfigError, match="no region named 'beak'; there are lower_teeth, upper_teeth"):
        Trainer(config(regions="beak", init_from=str(trained)), head, ColoredSpheres(), tmp_path)
    with pytest.raises(ConfigError, match="one after the other"):
        config(regions=REGION, expressions=True, init_from=str(trained))
    with pytest.raises(ConfigError, match="starts from weights"):
        config(regions=REGION)
    assert load_config("regions").region_names == ("upper_teeth", "lower_teeth", "tongue", "mouth_interior")


def test_a_run_keeps_the_texels_of_the_weights_it_starts_from(head, trained, tmp_path):
    """They were laid out on an earlier form of the head, where a model of today's would have others."""
    model, info = load_weights(trained, head)
    kept = np.sort(np.random.default_rng(0).permutation(len(model.layout))[:-7])
    layout = TexelLayout(
        model.layout.grid, *(getattr(model.layout, name)[kept] for name in ("texel", "face", "barycentric")), model.layout.uv
    )
    fewer = GRMM(head, model.config, layout)
    save_weights(tmp_path / "fewer.safetensors", fewer, info)
    path = renewed(head, tmp_path / "fewer.safetensors", tmp_path / "run")
    np.testing.assert_array_equal(load_weights(path, head)[0].layout.texel, layout.texel)
    assert len(GRMM(head, model.config).layout) == len(layout) + 7
