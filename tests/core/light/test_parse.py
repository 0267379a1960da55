"""Lights in words, and pictures of surroundings from files."""

from __future__ import annotations

import math

import numpy as np
import pytest

from grmm_core.cli import main
from grmm_core.errors import ConfigError, FileAccessError, FileFormatError
from grmm_core.light.lamps import Area, Sun
from grmm_core.light.parse import lighting_of
from grmm_core.pictures.images import read_exr_rgb, write_exr


@pytest.fixture
def sky(tmp_path):
    """Half of it red, at the person's left."""
    picture = np.full((16, 32, 3), 0.1, np.float32)
    picture[:, 4:12] = [2.0, 0.2, 0.1]
    path = tmp_path / "sky.exr"
    write_exr(path, {name: picture[..., k] for k, name in enumerate("RGB")})
    return path, picture


def test_no_words_and_the_studio_relight_nothing():
    assert lighting_of([]) is None
    assert lighting_of(["studio"]) is None


def test_words_are_lamps():
    light = lighting_of(["sun:90,0,3", "lamp:0,0,40,1,0.5,0.25", "world:0.2"])
    sun, lamp = light.lamps
    assert isinstance(sun, Sun)
    np.testing.assert_allclose(sun.direction, [1.0, 0.0, 0.0], atol=1e-9)
    assert (sun.strength, sun.color) == (3.0, (1.0, 1.0, 1.0))
    assert isinstance(lamp, Area)
    np.testing.assert_allclose(lamp.position, [0.0, 0.0, 1.5], atol=1e-9)
    np.testing.assert_allclose(lamp.direction, [0.0, 0.0, -1.0], atol=1e-9)
    assert (lamp.strength, lamp.color) == (40.0, (1.0, 0.5, 0.25))
    np.testing.assert_allclose(light.surroundings.irradiance(np.array([[0.0, 1.0, 0.0]])), [[0.2 * math.pi] * 3], rtol=1e-5)


def test_a_picture_of_surroundings_is_read_scaled_and_turned(sky):
    path, picture = sky
    np.testing.assert_array_equal(read_exr_rgb(path), picture)
    left, right = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])[:, None]

    def red(word, at):
        around = lighting_of([word]).surroundings
        spots = sum(max(0.0, float(at[0] @ spot.direction)) * spot.irradiance[0] for spot in around.spots)
        return float(around.irradiance(at)[0, 0]) + spots

    assert red(f"env:{path}", left) > 3 * red(f"env:{path}", right)
    assert red(f"env:{path},2", left) == pytest.approx(2 * red(f"env:{path}", left), rel=1e-4)
    assert red(f"env:{path},1,180", right) == pytest.approx(red(f"env:{path}", left), rel=0.02)
    commas = path.with_name("sky, noon,3.exr")
    commas.write_bytes(path.read_bytes())
    assert red(f"env:{commas},2", left) == red(f"env:{path},2", left)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["moon"], "not understood"),
        (["sun:1,2"], "not understood"),
        (["sun:a,b,c"], "not understood"),
        (["lamp:0,0,-5"], "^An area light .*below zero"),
        (["sun:0,0,nan"], "^A sun light .*not finite"),
        (["world:1", "world:2"], "Only one surrounding"),
        (["studio", "sun:0,0,1"], "stands alone"),
        (["sun:0,0,1", "photo:2"], "stands alone"),
        (["env:sky.png"], "not understood"),
        (["env:a.exr,x"], "not understood"),
    ],
)
def test_words_that_are_no_light_are_one_sentence(words, what):
    with pytest.raises(ConfigError, match=what):
        lighting_of(words)


def test_pictures_that_cannot_be_read_are_one_sentence(tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        lighting_of([f"env:{tmp_path / 'missing.exr'}"])
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(FileFormatError, match="no OpenEXR picture"):
        lighting_of([f"env:{tmp_path / 'text.exr'}"])
    write_exr(tmp_path / "depth.exr", {"Z": np.ones((4, 8), np.float32)})
    with pytest.raises(FileFormatError, match="R, G and B"):
        lighting_of([f"env:{tmp_path / 'depth.exr'}"])


def test_the_command_renders_in_a_light(sky, tmp_path, capsys):
    path, _ = sky
    files = []
    for name, words in (("flat", ()), ("lit", ("--light", f"env:{path}", "--light", "sun:-60,20,1"))):
        files.append(tmp_path / f"{name}.npz")
        assert main(["render", "default", "-o", str(files[-1]), "--size", "64", *words]) == 0
    flat, lit = (np.load(file)["rgb"] for file in files)
    assert np.abs(flat - lit).mean() > 0.02
    assert main(["render", "default", "-o", str(tmp_path / "no.png"), "--light", "moon"]) != 0
    assert "not understood" in capsys.readouterr().err
    assert not (tmp_path / "no.png").exists()
