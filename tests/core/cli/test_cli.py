"""The `grmm` command: information, errors in one sentence, exit codes, progress, measuring."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from grmm_core.avatar import load_avatar
from grmm_core.cli import build_parser
from grmm_core.cli.console import Console
from grmm_core.jobs.progress import Progress
from grmm_core.jobs.stages import CAPTURE

ROOT = Path(__file__).resolve().parents[3]

ROOT = Path(__file__).resolve().parents[3]


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


def test_sample_makes_an_avatar_that_renders(grmm, render, weights, tmp_path):
    path = tmp_path / "person.grmm"
    code, out, _ = grmm("sample", "--seed", 5, "-o", path, "--weights", weights, "--json")
    assert code == 0
    assert json.loads(out)["name"] == "Sample 5"
    again = tmp_path / "again.grmm"
    assert grmm("sample", "--seed", 5, "-o", again, "--weights", weights)[0] == 0
    np.testing.assert_array_equal(load_avatar(path).z_id, load_avatar(again).z_id)
    assert render(path, "-o", tmp_path / "x.png", "--size", "32")[0] == 0
    picture = tmp_path / "picture.png"
    code, _, err = grmm("sample", "-o", picture, "--weights", weights)
    assert (code, picture.exists()) == (1, False)
    assert "does not end in .grmm" in err
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
        (["info", "photo.jpg"], "does not exist"),
        (["info", __file__], "neither an avatar"),
        (["info", "sample:3"], "a person without a file"),
        (["render", __file__, "-o", "x.png"], "is no avatar"),
        (["render", "default", "-o", "x.png", "--hair-set", "melanin=5"], "goes from 0 to 1"),
        (["render", "default", "-o", "x.png", "--hair-set", "beard.length=0"], "goes from 0.15 to 1.6"),
        (["export", "default", "-o", "x.obj", "--hair", "long"], "hold no strands"),
        (["export", "default", "-o", "x.glb", "--mesh", "--hair-set", "length=0.5"], "hold no strands"),
        (["evaluate", "default", "--data", "nothing", "-o", "results"], "nothing does not exist"),
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


@pytest.mark.parametrize(
    ("arguments", "first"), [("info", "grmm: "), ("render default -o x.png --list-controls", "name "), ("--help", "usage: ")]
)
def test_the_module_runs_and_survives_a_closed_pipe(arguments, first):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = f'"{sys.executable}" -m grmm_core {arguments} | head -1; exit "${{PIPESTATUS[0]}}"'
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, env=environment, timeout=60)
    assert result.stdout.startswith(first)
    assert result.stderr == ""


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


def test_libraries_find_how_their_threads_shall_wait():
    """Numpy and torch read it when they are loaded, so the command sets it before."""
    program = (
        "import os, sys; import grmm_core.cli; assert not {'numpy', 'torch'} & set(sys.modules);"
        "grmm_core.cli.main(['--version']);"
        "print(os.environ['OMP_WAIT_POLICY'], os.environ['OPENBLAS_NUM_THREADS'])"
    )
    names = ("OMP_WAIT_POLICY", "OPENBLAS_NUM_THREADS")
    bare = {name: value for name, value in os.environ.items() if name not in names}
    for environment, said in ((bare, "PASSIVE 1"), ({**bare, "OPENBLAS_NUM_THREADS": "4"}, "PASSIVE 4")):
        done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=60)
        assert done.stdout.splitlines()[-1:] == [said], done.stderr


def test_json_has_no_nan():
    out = io.StringIO()
    Console(True, stdout=out).result({"a": float("nan"), "b": np.float32(2.0), "c": np.arange(2), "d": Path("x")})
    assert json.loads(out.getvalue()) == {"a": None, "b": 2.0, "c": [0, 1], "d": "x"}


@pytest.mark.slow
def test_bench_measures_ratios(grmm, weights):
    code, out, _ = grmm("bench", "--quick", "--weights", weights, "--engine", "torch", "--threads", "1", "--json")
    figures = json.loads(out)
    assert code == 0
    assert sum(stage["share"] for stage in figures["stages"].values()) == pytest.approx(1.0)
    assert figures["caching"]["everything"]["ratio"] == 1.0
    assert figures["engines"]["expression"]["ratio"] > 0
    assert set(figures["hair"]) == {"none", "groom:crop", "groom:long", "none from behind", "groom:long from behind"}
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
