"""What the tests of the `grmm` command share: the command itself, and tiny weights."""

from __future__ import annotations

import pytest

from grmm_core.cli import main


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture
def grmm(capsys):
    def call(*arguments: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def render(grmm, weights):
    def call(*arguments: object) -> tuple[int, str, str]:
        return grmm("render", *arguments, "--weights", weights, "--device", "cpu")

    return call
