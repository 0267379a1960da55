"""`grmm render`: pictures, passes, hair, performances."""

from __future__ import annotations

import argparse
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from grmm_core.avatar import save_avatar
from grmm_core.cli.common import add_hair, hair_of
from grmm_core.fitting.photo_light import SUNS
from grmm_core.fitting.result import LIGHT
from grmm_core.model.people import default_avatar
from grmm_core.model.weights_file import read_weights
from grmm_core.pictures.color import scene_linear_premultiplied
from grmm_core.session import EMPTY_DEPTH, create_session

ROOT = Path(__file__).resolve().parents[3]


def read_png(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_render_writes_a_picture_with_straight_alpha(render, tmp_path):
    path = tmp_path / "bild ü.png"
    code, out, err = render("default", "-o", path, "--size", "80x60")
    assert (code, out, err) == (0, f"Wrote {path}.\n", "")
    picture = read_png(path)
    assert picture.shape == (60, 80, 4)
    assert picture[0, 0].tolist() == [0, 0, 0, 0]
    assert picture[30, 40, 3] > 240
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_render_follows_its_options(render, tmp_path):
    def picture(*options):
        path = tmp_path / "x.png"
        assert render("default", "-o", path, "--size", "64", *options)[0] == 0
        return read_png(path).astype(int)

    front = picture()
    for options in ("--yaw 40", "--pitch 30", "--distance 1.6", "--fov 12", "--no-refine", "--set jaw.x=0.4",
                    "--set shape.0=3 --set laugh=1", "--set jawOpen=0 jawOpen=1", "--lod 1"):  # fmt: skip
        assert np.abs(picture(*options.split()) - front).max() > 8, options
    np.testing.assert_array_equal(picture("--set", "jawOpen=0"), front)
    white = picture("--background", "1,1,1")
    assert white.shape == (64, 64, 3)
    assert (white[0, 0] == 255).all()


def test_render_writes_every_pass(render, tmp_path):
    path = tmp_path / "x.png"
    passes = "rgb,alpha,depth,raw,normal,mask,features"
    code, out, _ = render("default", "-o", path, "--size", "48", "--passes", passes, "--json")
    facts = json.loads(out)
    assert code == 0
    assert facts["files"]["depth"] == str(tmp_path / "x.depth.npy")
    assert (facts["width"], facts["height"], facts["weights"]) == (48, 48, "tiny")
    depth = np.load(tmp_path / "x.depth.npy")
    assert depth.shape == (48, 48)
    assert depth[0, 0] == np.float32(EMPTY_DEPTH)
    assert 0.8 < depth.min() < 1.1
    assert np.load(tmp_path / "x.features.npy").shape == (48, 48, 4)
    alpha = read_png(tmp_path / "x.alpha.png")
    assert alpha.max() > 60_000  # 16 bits
    header = (tmp_path / "x.normal.png").read_bytes()[16:26]
    assert struct.unpack(">IIBB", header) == (48, 48, 16, 2)
    assert read_png(tmp_path / "x.raw.png").shape == (48, 48, 4)


def test_passes_of_light_add_up_to_the_picture(render, tmp_path):
    """In the files beside a PNG, which had the red channel of both alone, and in an OpenEXR by the names of color."""
    common = ("default", "--size", "48", "--light", "lamp:40,20,60", "--no-refine", "--passes", "diffuse,specular,shadow")
    assert render(*common, "-o", tmp_path / "x.npz")[0] == 0
    assert render(*common, "-o", tmp_path / "x.png")[0] == 0
    assert render(*common, "-o", tmp_path / "x.exr")[0] == 0
    arrays = np.load(tmp_path / "x.npz")
    parts = [np.load(tmp_path / f"x.{name}.npy") for name in ("diffuse", "specular")]
    for part, name in zip(parts, ("diffuse", "specular"), strict=True):
        np.testing.assert_array_equal(part, arrays[name])
    seen = arrays["alpha"][..., 0] > 0.99
    whole = scene_linear_premultiplied(arrays["rgb"], arrays["alpha"])[..., :3]
    np.testing.assert_allclose(np.minimum(sum(parts), 1.0)[seen], whole[seen], atol=0.02)
    assert read_png(tmp_path / "x.shadow.png").max() > 60_000  # 16 bits
    channels = (tmp_path / "x.exr").read_bytes()[:600]
    assert all(f"{name}.{letter}\0".encode() in channels for name in ("diffuse", "specular") for letter in "RGB")


def test_what_is_not_said_of_hair_is_the_persons_own():
    """A cut by --hair-set length=0.7 had dyed blond hair black."""
    parser = argparse.ArgumentParser()
    add_hair(parser)
    with create_session("local") as session:
        person = session.open("library:freckles")
    assert person.hair is not None
    for options in ("--hair-set length=0.7", "--hair long", "--hair long --hair-set frizz=0.5"):
        worn = hair_of(parser.parse_args(options.split()), person).settings
        assert worn is not None
        assert worn.color_key == person.hair.color_key
    cut = hair_of(parser.parse_args(["--hair-set", "brows.length=0.5"]), person)
    assert cut.settings is None
    assert cut.parts["brows"] == person.hair_parts["brows"].changed(length=0.5)
    assert hair_of(parser.parse_args([]), person).settings is None


def test_render_puts_hair_on(render, tmp_path):
    path = tmp_path / "x.png"
    assert render("default", "-o", path, "--size", "64", "--yaw", "180", "--passes", "hair", "--hair", "bob")[0] == 0
    assert read_png(tmp_path / "x.hair.png").max() > 60_000  # 16 bits
    assert render("default", "-o", path, "--size", "64", "--hair", "crop")[0] == 0
    dark = read_png(path).astype(int)
    assert render("default", "-o", path, "--size", "64", "--hair", "crop", "--hair-set", "melanin=0", "length=0.7")[0] == 0
    assert np.abs(read_png(path).astype(int) - dark).max() > 40
    face = ("default", "-o", path, "--size", "64", "--passes", "hair")
    assert render(*face, "--beard", "full", "--brows", "thin", "--hair-set", "beard.length=1.4")[0] == 0
    assert read_png(tmp_path / "x.hair.png")[40:].max() > 20_000
    for options, word in (
        ("--hair wig", "There is no groom 'wig'"),
        ("--hair crop --hair-set shine=1", "Hair has no setting"),
        ("--brows wig", "There is no groom of brows 'wig'"),
        ("--hair-set nose.length=1", "Hair has no part 'nose'"),
    ):
        code, _, err = render("default", "-o", path, "--size", "64", *options.split())
        assert code == 1
        assert word in err


def test_render_plays_a_performance_with_hair_that_swings(render, tmp_path):
    """A frame is the same whether all are drawn, it alone, or from a bake."""
    rows = [f"00:00:00:{frame:02d}.000,61,0.1,{0.06 * min(frame, 8)}" for frame in range(14)]
    (tmp_path / "turn.csv").write_text("\n".join(["Timecode,BlendShapeCount,JawOpen,HeadYaw", *rows]) + "\n")
    common = ("default", "--size", "64", "--no-refine", "--hair", "long", "--performance", tmp_path / "turn.csv", "--fps", "24")
    assert render(*common, "-o", tmp_path / "all_##.png", "--hair-swing")[0] == 0
    count = len(list(tmp_path.glob("all_*.png")))
    assert count >= 5
    assert render(*common, "-o", tmp_path / "one_##.png", "--hair-swing", "--frames", "3")[0] == 0
    assert [file.name for file in tmp_path.glob("one_*.png")] == ["one_03.png"]
    bake = tmp_path / "bake.npz"
    for name in ("kept", "again"):
        assert render(*common, "-o", tmp_path / f"{name}_##.png", "--hair-swing", bake, "--frames", "3-4")[0] == 0
    assert render(*common, "-o", tmp_path / "stiff_##.png", "--frames", "3")[0] == 0
    pictures = {name: read_png(tmp_path / f"{name}_03.png").astype(int) for name in ("all", "one", "kept", "again", "stiff")}
    np.testing.assert_array_equal(pictures["all"], pictures["one"])
    np.testing.assert_array_equal(pictures["kept"], pictures["again"])
    assert np.abs(pictures["all"] - pictures["kept"]).mean() < 0.5
    assert np.abs(pictures["all"] - pictures["stiff"]).mean() > 0.5
    for options, word in (("--hair-swing", "name one with --performance"), ("--frames 2", "name one with --performance")):
        code, _, err = render("default", "-o", tmp_path / "x.png", *options.split())
        assert code == 1
        assert word in err
    code, _, err = render(*common, "-o", tmp_path / "x.png", "--frames", "900")
    assert code == 1
    assert "no frame 900" in err


def test_render_writes_arrays_and_exr(render, tmp_path):
    assert render("default", "-o", tmp_path / "x.npz", "--size", "32", "--passes", "rgb,depth")[0] == 0
    arrays = np.load(tmp_path / "x.npz")
    assert {name: array.shape[2] for name, array in arrays.items()} == {"rgb": 3, "depth": 1, "alpha": 1}
    assert render("default", "-o", tmp_path / "x.exr", "--size", "32", "--passes", "rgb,depth")[0] == 0
    data = (tmp_path / "x.exr").read_bytes()
    assert data[:4] == b"\x76\x2f\x31\x01"
    for channel in (b"R\0", b"A\0", b"depth.Z\0"):
        assert channel in data[:400]


def test_render_in_the_light_of_its_photo(render, weights, tmp_path):
    """A photo lit from the person's left, whose light an avatar's file holds; the second photo has the studio's."""
    info = read_weights(weights).info
    suns = np.zeros((2, len(SUNS), 3), np.float32)
    suns[0, max(range(len(SUNS)), key=lambda k: SUNS[k].direction[0])] = 3.0
    light = {"suns": suns, "around": np.zeros((2, 9, 3), np.float32), "tone": np.ones((2, 3)), "level": np.ones((2, 3))}
    path, picture = tmp_path / "photo.grmm", tmp_path / "x.png"
    tracking = {LIGHT + name: values.astype(np.float32) for name, values in light.items()}
    save_avatar(replace(default_avatar(info, info.config.z_exp), tracking=tracking), path)

    def sides(*options):
        code, _, err = render(path, "-o", picture, "--size", "48", *options)
        assert code == 0, err
        rgb = read_png(picture).astype(float)
        rgb = rgb[..., :3] * (rgb[..., 3:] > 200)
        return rgb[:, :24].sum(), rgb[:, 24:].sum()

    left, right = sides("--light", "photo")
    assert max(left, right) > 3.0 * min(left, right)
    even = sides()
    assert max(even) < 1.5 * min(even)
    for words, sentence in (
        ("photo:2", "does not know the light"),
        ("photo:3", "does not know its photo"),
        ("photo:x", "name one"),
    ):
        code, _, err = render(path, "-o", picture, "--light", words)
        assert code != 0
        assert sentence in err
