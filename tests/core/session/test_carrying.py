"""Avatars of weights that are not installed: their head and colors are carried over to those that are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.avatar import AssetReference, load_avatar, save_avatar
from grmm_core.avatar.library import library_path
from grmm_core.errors import FileFormatError
from grmm_core.geometry.camera import Camera
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
