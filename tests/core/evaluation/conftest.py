"""A tiny model and captures of its own pictures, for the tests of the evaluation."""

from __future__ import annotations

import pytest
from evaluation_data import write_own_pictures
from tiny_model import write_tiny_weights

from grmm_core.evaluation.scene import Scene


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture(scope="module")
def scene(weights):
    return Scene(weights)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    return write_own_pictures(tmp_path_factory.mktemp("capture"), scene)
