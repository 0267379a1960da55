"""The `grmm` command: results, files, errors in one sentence, exit codes."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from grmm_core.avatar import load_avatar
from grmm_core.cli import build_parser, main
from grmm_core.cli.console import Console
from grmm_core.formats import formats, read_splats, suffixes
from grmm_core.jobs.progress import Progress
from grmm_core.jobs.stages import CAPTURE
from grmm_core.session import EMPTY_DEPTH

ROOT = Path(__file__).resolve().parents[3]


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


def read_png(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_every_command_has_help(grmm):
    code, out, _ = grmm("--help")
    assert code == 0
    for name in ("info", "render", "sample"):
        assert name in out
        code, text, _ = grmm(name, "--help")
        assert code == 0
        assert "--json" in text
        assert "--debug" in text


@pytest.mark.parametrize(
    "line", ["", "dance", "render default", "render default -o x.png --size 0x9", "render default -o x.png --passes beauty",
             "render default -o x.png --yaw left"]
)  # fmt: skip
def test_wrong_usage_is_exit_code_2(grmm, line):
    code, out, err = grmm(*line.split())
    assert code == 2
    assert out == ""
    assert "grmm" in err


def test_info_describes_the_installation(grmm):
    code, out, _ = grmm("info", "--json")
    facts = json.loads(out)
    assert code == 0
    assert facts["libraries"]["numpy"] == np.__version__
    assert set(facts["rasterisers"]) == {"torch", "cpu", "cuda"}
    assert "open_head" in [head["name"] for head in facts["head models"]]
    code, out, _ = grmm("info")
    assert code == 0
    assert f"numpy: {np.__version__}" in out


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


def test_sample_makes_an_avatar_that_renders(grmm, render, weights, tmp_path):
    path = tmp_path / "person.grmm"
    code, out, _ = grmm("sample", "--seed", 5, "-o", path, "--weights", weights, "--json")
    assert code == 0
    assert json.loads(out)["name"] == "Sample 5"
    again = tmp_path / "again.grmm"
    assert grmm("sample", "--seed", 5, "-o", again, "--weights", weights)[0] == 0
    np.testing.assert_array_equal(load_avatar(path).z_id, load_avatar(again).z_id)
    assert render(path, "-o", tmp_path / "x.png", "--size", "32")[0] == 0
    code, out, _ = grmm("info", path, "--json")
    assert json.loads(out)["name"] == "Sample 5"
    assert json.loads(out)["from photos"] is False


def test_info_describes_the_default_avatar(grmm):
    facts = json.loads(grmm("info", "default", "--json")[1])
    assert (facts["name"], facts["kind"], facts["painted"]) == ("Woman, 43, layered hair", "grmm-avatar", True)


def test_info_describes_weights(grmm, weights):
    code, out, _ = grmm("info", weights, "--json")
    assert code == 0
    assert json.loads(out)["people"] == 4


def documented_commands(repository):
    """Command lines of `grmm` in the README and in docs/, without comments and without what stands in brackets."""
    for path in [repository / "README.md", *sorted((repository / "docs").glob("*.md"))]:
        for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", path.read_text(encoding="utf-8"), re.S | re.M):
            for line in [] if language else block.splitlines():
                words = shlex.split(line, comments=True)
                if words[:1] == ["grmm"] and not re.search(r"[\[|<]|\.\.\.", line.partition("#")[0]):
                    yield path.name, words[1:]


def test_commands_in_the_documents_are_understood(repository):
    found = list(documented_commands(repository))
    assert len(found) > 8
    parser = build_parser()[0]
    for document, words in found:
        try:
            parser.parse_args(words)
        except SystemExit:
            pytest.fail(f"{document}: grmm {' '.join(words)}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["info", "none.grmm"], "does not exist"),
        (["info", "photo.jpg"], "neither an avatar"),
        (["render", "none.grmm", "-o", "x.png"], "does not exist"),
        (["render", "default", "-o", "no folder/x.png"], "folder no folder does not exist"),
        (["render", "default", "-o", "x.jpg"], "does not end in"),
        (["render", "default", "-o", "x.png", "--set", "jawOpne=1"], "no control named 'jawOpne'"),
        (["render", "default", "-o", "x.png", "--set", "jawOpen=nan"], "not a finite number"),
        (["render", "default", "-o", "x.png", "--set", "jawOpen"], "not of the form NAME=NUMBER"),
        (["render", "default", "-o", "x.png", "--weights", "none"], "not installed"),
        (["render", "default", "-o", "x.png", "--fov", "400"], "field of view"),
        (["sample", "-o", "no folder/x.grmm"], "folder no folder does not exist"),
    ],
)
def test_errors_are_one_sentence_and_exit_code_1(grmm, arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = grmm(*arguments)
    assert (code, out) == (1, "")
    assert message in err
    assert err.startswith("grmm: ")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_unwritable_folders_leave_nothing(render, tmp_path, monkeypatch):
    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("grmm_core.files.access.os.fsync", full_disk)
    code, _, err = render("default", "-o", tmp_path / "x.png", "--size", "16")
    assert code == 1
    assert "no space left on device" in err
    assert list(tmp_path.iterdir()) == []


def test_defects_show_a_traceback_only_under_debug(grmm, monkeypatch, caplog):
    from grmm_core.cli import info

    def broken():
        raise ValueError("two\nlines")

    monkeypatch.setattr(info, "installation", broken)
    code, _, err = grmm("info")
    assert code == 1
    assert err == "grmm: Internal error (ValueError: two lines); run again with --debug and report it.\n"
    assert not caplog.records
    assert grmm("info", "--debug")[0] == 1
    assert caplog.records[-1].exc_info[0] is ValueError


def test_interrupting_is_one_sentence(grmm, monkeypatch):
    from grmm_core.cli import info

    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr(info, "installation", interrupt)
    assert grmm("info") == (1, "", "grmm: Cancelled.\n")


def test_the_module_runs_and_survives_a_closed_pipe():
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = f'"{sys.executable}" -m grmm_core info | head -1; exit "${{PIPESTATUS[0]}}"'
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, env=environment, timeout=60)
    assert result.stdout.startswith("grmm: ")
    assert "Traceback" not in result.stderr


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_drawn_on_a_terminal_only():
    for stream, as_json, drawn in ((Terminal(), False, True), (io.StringIO(), False, False), (Terminal(), True, False)):
        console = Console(as_json, stdout=io.StringIO(), stderr=stream)
        with console.progress(CAPTURE) as show:
            show(Progress("shots", 0.5, 200.0))
        assert ("capture [##############..............] 50% Rendering, about 3 min left" in stream.getvalue()) == drawn
    assert stream.getvalue() == ""


def test_events_are_progress_and_result_one_object_a_line():
    out, err = io.StringIO(), Terminal()
    console = Console(as_events=True, stdout=out, stderr=err)
    with console.progress(CAPTURE) as show:
        show(Progress("shots", 0.5, 200.0, "a.png"))
    console.line("for people")
    console.result({"file": Path("x"), "error": float("nan")})
    progress, done = map(json.loads, out.getvalue().splitlines())
    assert progress.pop("event") == "progress"
    assert Progress.from_json(progress) == Progress("shots", 0.5, 200.0, "a.png")
    assert done == {"event": "done", "file": "x", "error": None}
    assert err.getvalue() == ""
    console.error("No\nroom.")
    assert json.loads(out.getvalue().splitlines()[-1]) == {"event": "error", "message": "No room."}
    assert err.getvalue() == "grmm: No room.\n"


def test_a_package_that_is_missing_is_named(grmm, monkeypatch):
    from grmm_core.cli import info

    def broken():
        raise ModuleNotFoundError("No module named 'numba.core'", name="numba")

    monkeypatch.setattr(info, "installation", broken)
    code, _, err = grmm("info")
    assert code == 1
    assert err == f"grmm: The Python {sys.executable} lacks the package numba; install it there.\n"


def test_json_has_no_nan():
    out = io.StringIO()
    Console(True, stdout=out).result({"a": float("nan"), "b": np.float32(2.0), "c": np.arange(2), "d": Path("x")})
    assert json.loads(out.getvalue()) == {"a": None, "b": 2.0, "c": [0, 1], "d": "x"}


@pytest.fixture
def export(grmm, weights):
    def call(*arguments: object) -> tuple[int, str, str]:
        return grmm("export", "default", *arguments, "--weights", weights, "--device", "cpu")

    return call


@pytest.mark.parametrize("suffix", suffixes(formats("splats", written=True), shared=False))
def test_exported_splats_are_read_back(grmm, export, tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    code, out, _ = export("-o", path, "--set", "jawOpen=0.5", "--json")
    assert code == 0
    cloud = read_splats(path)
    assert cloud.count == json.loads(out)["gaussians"]
    assert cloud.means[:, 1].max() > 0.1  # the top of the head is up again
    assert 0.1 < cloud.colors().mean() < 0.9
    facts = json.loads(grmm("info", path, "--json")[1])
    assert facts["splats"] == cloud.count
    assert facts["size in metres"][1] > 0.2


def test_formats_options_are_flags(export, tmp_path):
    import gzip

    assert export("-o", tmp_path / "x.spz", "--spz-version", "2")[0] == 0
    assert int.from_bytes(gzip.decompress((tmp_path / "x.spz").read_bytes())[4:8], "little") == 2
    code, out, _ = export("-o", tmp_path / "x.splat", "--json")
    assert code == 0
    assert any("no view dependence" in sentence for sentence in json.loads(out)["warnings"])


def test_exported_meshes_follow_the_controls(export, tmp_path):
    heights = {}
    for name, setting in (("closed", "jawOpen=0"), ("open", "jawOpen=1")):
        path = tmp_path / f"{name}.obj"
        assert export("-o", path, "--set", setting)[0] == 0
        rows = [line.split()[1:4] for line in path.read_text().splitlines() if line.startswith("v ")]
        heights[name] = np.array(rows, float)
    assert 0.01 < np.abs(heights["open"] - heights["closed"]).max() < 0.1
    code, out, _ = export("-o", tmp_path / "x.glb", "--mesh", "--json")
    assert code == 0
    assert json.loads(out)["morphs"] == 52


def test_exported_arrays_are_complete(export, tmp_path):
    assert export("-o", tmp_path / "x.npz", "--sh-degree", "2")[0] == 0
    arrays = np.load(tmp_path / "x.npz")
    assert arrays["sh"].shape == (len(arrays["means"]), 9, 3)
    assert arrays["vertices"].shape == arrays["displacement"].shape
    assert arrays["faces"].max() == len(arrays["vertices"]) - 1
    code, _, err = export("-o", tmp_path / "x.fbx")
    assert code == 1
    assert "cannot be written as '.fbx'" in err


def test_harmonics_reproduce_the_colors_seen(weights):
    """Degree 3 follows the decoder's view dependence closer than the mean color, from where Gaussians are seen."""
    from grmm_core.controls.frame import Controls
    from grmm_core.session import create_session
    from grmm_core.session.harmonics import fit_harmonics, harmonic_basis

    with create_session("local", weights=weights, device="cpu", threads=1) as session:
        info = session.open("default")
        view = np.array([0.6, 0.0, 0.8])
        cloud = session.gaussians(info.id, Controls(), view)
        seen = (cloud.means - cloud.means.mean(0)) @ view > 0.03
        errors = []
        for degree in (0, 1, 3):
            coefficients = fit_harmonics(session, info.id, Controls(), degree)
            fitted = 0.5 + np.einsum("c,ncx->nx", harmonic_basis(-view[None], degree)[0], coefficients)
            errors.append(np.abs(fitted - cloud.colors)[seen].mean())
    assert errors[2] < 0.5 * errors[0]
    assert errors[1] < errors[0]


@pytest.mark.slow
def test_bench_measures_ratios(grmm, weights):
    code, out, _ = grmm("bench", "--quick", "--weights", weights, "--threads", "1", "--json")
    figures = json.loads(out)
    assert code == 0
    assert sum(stage["share"] for stage in figures["stages"].values()) == pytest.approx(1.0)
    assert figures["caching"]["everything"]["ratio"] == 1.0
    assert figures["engines"]["expression"]["ratio"] > 0
    assert set(figures["hair"]) == {"none", "groom:crop", "groom:long"}
    assert figures["rasteriser against plain torch"]["forward"]["times faster"] > 1
    assert figures["rasteriser by N_g"]["N_g 128"]["ratio"] == 1.0
    assert figures["rasteriser by threads"]["1 threads"]["speed forward"] == 1.0
    limits = figures["rasteriser and arithmetic"]
    assert 0 < limits["blended pairs"]["limit ms"] < limits["our blocks"]["limit ms"] < limits["whole tiles"]["limit ms"]
    assert figures["worker"]["frame"]["ratio"] > 0
    assert figures["peak memory MiB"] > 0
    assert "CUDA only" in figures["alternatives"]["gsplat"]


@pytest.mark.slow
def test_bench_measures_a_configuration(grmm):
    code, out, _ = grmm("bench", "--quick", "--config", "small", "--size", "64", "--json")
    figures = json.loads(out)
    assert code == 0
    assert sum(stage["share"] for stage in figures["stages"].values()) == pytest.approx(1.0)
    rates = figures["frames a second"]
    assert rates["animated expression"]["per second"] > rates["everything new"]["per second"] > 0


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Three frames of a Live Link Face file, 60 a second: a jaw that opens and a head that turns."""
    from grmm_core.controls.names import ARKIT_NAMES
    from grmm_core.formats import write_performance
    from grmm_core.performance import Performance

    weights = np.zeros((3, 52), np.float32)
    weights[:, ARKIT_NAMES.index("jawOpen")] = (0.0, 0.4, 0.8)
    path = tmp_path_factory.mktemp("recording") / "take.csv"
    turned = np.array([[0, 0, 0], [0.1, 0.2, 0.3], [0.2, 0.4, 0.5]])
    write_performance(path, Performance(np.arange(3) / 60, weights, 60.0, recorded_shapes=ARKIT_NAMES, head_rotation=turned))
    return path


@pytest.mark.parametrize(("name", "options"), [("h_##.ply", ()), ("h.obj", ("--set", "mouthSmileLeft=0.5"))])
def test_a_recording_becomes_a_file_for_each_frame(export, recording, tmp_path, name, options):
    code, out, err = export("-o", tmp_path / name, "--performance", recording, "--lod", "2", "--json", *options)
    assert code == 0, err
    facts = json.loads(out)
    assert facts["frames"] == 3
    files = sorted(tmp_path.iterdir())
    assert list(map(str, files)) == facts["files"]
    stem, suffix = ("h_0", ".ply") if "#" in name else ("h_000", ".obj")
    assert [file.name for file in files] == [f"{stem}{frame}{suffix}" for frame in range(3)]
    assert len({file.read_bytes() for file in files}) == 3
    code, out, _ = export("-o", tmp_path / name, "--performance", recording, "--lod", "2", "--json", "--fps", "120", *options)
    assert json.loads(out)["frames"] == 5


def test_recordings_are_converted_and_each_axis_of_the_head_can_be_flipped(grmm, recording, tmp_path):
    from grmm_core.formats import read_performance
    from grmm_core.formats.performances.turns import from_euler

    plain = from_euler(read_performance(recording).head_rotation)
    for axis, name in enumerate(("pitch", "yaw", "roll")):
        code, _, err = grmm("export", "default", "-o", tmp_path / "x.json", "--performance", recording, f"--flip-{name}")
        assert code == 0, err
        found = read_performance(tmp_path / "x.json")
        signs = np.where(np.arange(3) == axis, -1.0, 1.0)
        assert from_euler(found.head_rotation) == pytest.approx(plain * signs, abs=1e-5)
        assert found.weights == pytest.approx(read_performance(recording).weights, abs=1e-5)
    assert grmm("export", "default", "-o", tmp_path / "y.json", "--performance", recording, "--landscape")[0] == 0
    assert from_euler(read_performance(tmp_path / "y.json").head_rotation) == pytest.approx(plain * [-1, -1, 1], abs=1e-5)
    facts = json.loads(grmm("info", recording, "--flip-yaw", "--json")[1])
    assert facts["frames"] == 3
    assert json.loads(grmm("info", "default", "--json")[1])["kind"] == "grmm-avatar"


def test_a_gaussian_avatars_folder_from_the_command_line(grmm, export, recording, tmp_path):
    from flame_files import write_flame_pickle
    from flame_head_files import flame_head_fields

    from grmm_core.formats.avatars.gaussian_avatars import read_gaussian_avatar

    code, _, err = export("-o", tmp_path / "folder", "--performance", recording)
    assert code == 1
    assert "--flame" in err
    assert not (tmp_path / "folder").exists()
    write_flame_pickle(tmp_path / "flame.pkl", flame_head_fields())
    options = ("--flame", tmp_path / "flame.pkl", "--lod", "1", "--sh-degree", "0", "--json")
    code, out, err = export("-o", tmp_path / "folder", "--performance", recording, *options)
    assert code == 0, err
    found = read_gaussian_avatar(tmp_path / "folder")
    assert (found.track.frame_count, found.cloud.count) == (3, json.loads(out)["gaussians"])
    assert np.ptp(found.track.jaw_rotation[:, 0]) > 0.05
    assert found.track.head_rotation[2] == pytest.approx([0.2, 0.4, 0.5], abs=1e-4)
    assert export("-o", tmp_path / "still", "--set", "jawOpen=0.8", *options)[0] == 0
    still = read_gaussian_avatar(tmp_path / "still").track
    assert still.frame_count == 1
    assert still.jaw_rotation[0] == pytest.approx(found.track.jaw_rotation[2], abs=1e-4)
    track = tmp_path / "track.npz"
    assert grmm("export", "default", "-o", track, "--performance", recording, "--flame", tmp_path / "flame.pkl")[0] == 0
    assert json.loads(grmm("info", track, "--json")[1])["expression coefficients"] == 100
    code, _, err = grmm("export", "default", "-o", tmp_path / "x.json", "--performance", track)
    assert code == 1
    assert "has FLAME's coefficients and needs your own FLAME file" in err


def test_a_lam_avatar_from_the_command_line(grmm, export, recording, tmp_path):
    code, out, err = export("-o", tmp_path / "a.zip", "--lod", "2", "--json")
    assert code == 0, err
    facts = json.loads(grmm("info", tmp_path / "a.zip", "--json")[1])
    assert facts["splats"] == json.loads(out)["gaussians"]
    assert len(facts["morph targets"]) == 52
    code, _, err = export("-o", tmp_path / "b.zip", "--performance", recording)
    assert code == 1
    assert "hold no performance" in err
    code, _, err = export("-o", tmp_path / "b.csv")
    assert code == 1
    assert "name one with --performance" in err


def test_every_format_that_blender_writes_is_written_here(grmm):
    """Alembic and USD are Blender's own exporters; everything else has a name that `grmm export` takes."""
    from grmm_core.formats import format_to_write

    kinds = ("splats", "mesh", "avatar", "arrays", "performance")
    written = formats(kinds, written=True)
    for one in written:
        name = Path("folder" if one.folder else f"a{one.suffix}")
        assert format_to_write(name, one.holds) is one
    text = grmm("export", "--help")[1]
    assert all(one.suffix in text for one in written)
