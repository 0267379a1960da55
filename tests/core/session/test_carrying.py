"""Avatars of weights that are not installed: their head and colors are carried over to those that are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.tiny_model import write_tiny_weights

from grmm_core.avatar import AssetReference, load_avatar, save_avatar
from grmm_core.avatar.library import library_path
from grmm_core.controls.frame import Controls
from grmm_core.errors import FileFormatError
from grmm_core.geometry.camera import Camera
from grmm_core.model.grmm import GRMM
from grmm_core.model.parameters import EXPRESSION_MAPS
from grmm_core.model.weights import load_weights, save_weights
from grmm_core.session import create_session
from grmm_core.session.values import Instance

LOST = AssetReference("early", "ab" * 32)


@pytest.fixture(scope="module")
def session():
    with create_session("local", device="cpu") as session:
        yield session


@pytest.fixture
def lost(tmp_path):
    """A library avatar as if it had been made on other weights, with codes and changes that fit these alone."""
    avatar = load_avatar(library_path("beard"))
    changes = {"decoders.appearance_mean": np.ones((7, 3), np.float32)}
    avatar = replace(avatar, weights=LOST, z_id=np.ones(5, np.float32), z_exp=np.ones(3, np.float32), deltas=changes)
    path = tmp_path / "lost.grmm"
    save_avatar(avatar, path)
    return path


def test_shape_and_colors_are_carried_over(session, lost, caplog):
    with caplog.at_level("WARNING", logger="grmm_core.session"):
        info = session.open(lost)
    assert "carried over" in caplog.text
    own = session.open("library:beard")
    assert info.weights_sha256 == own.weights_sha256
    np.testing.assert_array_equal(info.shape, own.shape)
    camera = Camera.orbit(96, 96, pitch=4.0, distance=1.1, fov=7.0, target=(0.0, -0.005, 0.03))  # nothing but the face
    numbers = (info.id, own.id, session.sample(3).id)
    colors, true, other = (session.render([Instance(number)], camera)["rgb"] for number in numbers)
    assert np.abs(colors - true).mean() < 0.5 * np.abs(other - true).mean()
    assert np.abs(colors - true).mean() < 0.05


def test_it_is_saved_as_an_avatar_of_the_present_weights(session, lost, tmp_path):
    session.save(session.open(lost).id, tmp_path / "kept.grmm")
    kept = load_avatar(tmp_path / "kept.grmm")
    assert kept.weights != LOST
    assert kept.provenance == load_avatar(lost).provenance


def test_without_a_painting_the_sentence_says_what_is_needed(session, lost):
    save_avatar(load_avatar(lost).with_pictures(b"", np.zeros((0, 0, 3), np.uint8)), lost)
    with pytest.raises(FileFormatError, match=r"needs the trained weights 'early'.*make the avatar anew"):
        session.open(lost)


@pytest.mark.parametrize("engine", ["torch", "plain"])
def test_weights_that_continue_others_draw_their_avatars(engine, tmp_path):
    """With more expression maps than the file's changes know, and these changes kept."""
    old, new, path = tmp_path / "old.safetensors", tmp_path / "new.safetensors", tmp_path / "made.grmm"
    model, info = load_weights(write_tiny_weights(old))
    larger = GRMM(model.head_model, model.config.replace(expression_maps=model.config.expression_maps + 2), model.layout)
    known, more = model.state_dict(), larger.state_dict()
    for name, value in more.items():
        rows = len(known[name])
        more[name] = torch.cat([known[name], torch.zeros_like(value[rows:])]) if rows < len(value) else known[name]
    larger.load_state_dict(more)
    save_weights(new, larger, replace(info, provenance={"continues": [info.sha256]}))

    controls, camera = Controls().set_named({"jawOpen": 0.8, "browInnerUp": 1.0}), Camera.orbit(64, 64)
    with create_session("local", engine=engine, weights=old) as session:
        session.save(session.sample(1).id, path)
        changes = {EXPRESSION_MAPS: np.full(tuple(known[EXPRESSION_MAPS].shape), 0.2, np.float32)}
        save_avatar(replace(load_avatar(path), deltas=changes), path)
        expected = session.render([Instance(session.open(path).id, controls)], camera)["rgb"]
    with create_session("local", engine=engine, weights=new) as session:
        opened = session.open(path)
        found = session.render([Instance(opened.id, controls)], camera)["rgb"]
    np.testing.assert_allclose(found, expected, atol=2e-3)  # maps are stored in eight bits once more
    other = replace(load_avatar(path), weights=LOST).with_pictures(b"", np.zeros((0, 0, 3), np.uint8))
    save_avatar(other, path)
    with create_session("local", engine=engine, weights=new) as session, pytest.raises(FileFormatError, match="not installed"):
        session.open(path)
