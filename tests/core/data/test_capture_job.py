"""A capture job without Blender: a stand-in draws small pictures, the rest is real. Killed, shared, full disk, options."""

from __future__ import annotations

import importlib.machinery
import json
import os
import subprocess
import sys
import time
import types
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dask_workers import kill_once_there_is, processes, two_workers
from PIL import Image
from progress_checks import check_progress

from grmm_core.cli import main
from grmm_core.data.claims import claim
from grmm_core.data.dataset import CaptureDataset, read_manifest
from grmm_core.data.layers import ALBEDO, NORMAL, PART_LAYER, PARTS
from grmm_core.data.types import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, Picture
from grmm_core.errors import ConfigError, FileAccessError
from grmm_core.jobs.stages import CAPTURE
from grmm_studio import capture
from grmm_studio import settings as settings_module
from grmm_studio.capture import Outcome, run_job
from grmm_studio.settings import STUDIO, CaptureSettings, check_settings, open_job
from grmm_studio.sheet import write_sheet

ROOT = Path(__file__).resolve().parents[3]
SETTINGS = CaptureSettings(subjects=3, shots=5, views=2, size=40)


class FakeStudio:
    """Pictures of noise that depend on person, shot and camera. `log` lists the shots, `pause` makes them slow."""

    log: Path | None = None
    pause = 0.0
    built = 0

    def __init__(self, *_):
        FakeStudio.built += 1

    def set_subject(self, subject):
        self.person, self.groom, self.displacement = subject, None, np.zeros((7, 3), np.float32)

    def set_shot(self, expression, pose, light):
        self.seed = zlib.crc32(self.person.name.encode() + expression.tobytes() + pose.tobytes())
        if self.log is not None:
            with self.log.open("a") as file:
                file.write(f"{self.seed}\n")
        time.sleep(self.pause)

    def render(self, camera, hair=True, light=None):
        tag = [
            self.seed,
            int(1e6 * (camera.world_to_camera[0, 0] + 1)),
            hair,
            0 if light is None else int(1e4 * light.strength),
        ]
        g = np.random.default_rng(tag)
        shape = (camera.height, camera.width)
        layers = {PART_LAYER: g.random((len(PARTS), *shape)), ALBEDO: g.random((*shape, 3)), NORMAL: g.random((*shape, 3))}
        return Picture(g.random((*shape, 3), np.float32), g.random(shape, np.float32), g.random(shape, np.float32), layers)

    def close(self):
        pass


@pytest.fixture(autouse=True)
def studio(monkeypatch):
    monkeypatch.setitem(sys.modules, "grmm_studio.scene", types.SimpleNamespace(Studio=FakeStudio))


# the job in a process of its own, which ends with an error's sentence
CHILD = """
import sys, types
from pathlib import Path
import test_capture_job as t
t.FakeStudio.log, t.FakeStudio.pause = Path(sys.argv[2]), float(sys.argv[3])
sys.modules["grmm_studio.scene"] = types.SimpleNamespace(Studio=t.FakeStudio)
if len(sys.argv) > 4:
    import resource
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[4]), resource.RLIM_INFINITY))
try:
    print(t.run_job(Path(sys.argv[1]), t.SETTINGS).made)
except t.FileAccessError as error:
    print(error)
"""


def start(folder, log, pause=0.0, *limit):
    arguments = [str(folder), str(log), str(pause), *map(str, limit)]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests" / "support"), str(Path(__file__).parent)]),
    }
    return subprocess.Popen([sys.executable, "-c", CHILD, *arguments], stdout=subprocess.PIPE, text=True, env=environment)


def content(folder):
    """All files but the temporary one of a process that was killed while it wrote."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(".tmp"))
    return {path.relative_to(folder): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """What an uninterrupted run leaves."""
    folder = tmp_path_factory.mktemp("whole")
    child = start(folder, folder.parent / "log")
    assert child.communicate()[0].strip() == "15"
    files = content(folder)
    assert len(files) == 1 + 3 * 2 + 15 * (2 + 2 * 2)
    return files


def test_a_killed_job_is_continued(tmp_path, whole):
    folder, log = tmp_path / "c", tmp_path / "log"
    for shots in (2, 5):
        child = start(folder, log, 0.03)
        while len(list(folder.glob("shots/*/*.json"))) < shots:
            assert child.poll() is None
            time.sleep(0.005)
        child.kill()
        child.communicate()
    assert 5 <= len(CaptureDataset(folder).shots) < 15
    assert run_job(folder, SETTINGS).complete == 15
    for path in folder.rglob(".grmm-*.tmp"):  # the file that a killed process was writing
        path.unlink()
    assert content(folder) == whole
    assert run_job(folder, SETTINGS) == Outcome(0, 15, 15)


def test_the_studio_is_built_anew_after_many_people(tmp_path, whole, monkeypatch):
    for kept, built in ((3, 1), (2, 3), (1, 6)):  # the order is 0 1 2 0 1 2
        monkeypatch.setattr(capture, "PEOPLE_IN_STUDIO", kept)
        monkeypatch.setattr(FakeStudio, "built", 0)
        run_job(tmp_path / str(kept), SETTINGS)
        assert FakeStudio.built == built
        assert content(tmp_path / str(kept)) == whole


def test_processes_share_a_job(tmp_path, whole):
    folder, log = tmp_path / "c", tmp_path / "log"
    children = [start(folder, log, 0.05) for _ in range(2)]
    made = [int(child.communicate()[0]) for child in children]
    assert sum(made) == 15
    assert min(made) > 0
    shots = log.read_text().split()
    assert len(shots) == len(set(shots)) == 15
    assert content(folder) == whole


STAND_IN = """
import sys, types
from pathlib import Path
import test_capture_job as t
t.FakeStudio.log, t.FakeStudio.pause = Path({log!r}), 0.1
sys.modules["grmm_studio.scene"] = types.SimpleNamespace(Studio=t.FakeStudio)
"""


def test_a_cluster_makes_the_same_capture(tmp_path, whole):
    """One of its workers is killed in the middle; that costs the piece that it was at, which is made again."""
    folder = tmp_path / "c"
    with two_workers(STAND_IN.format(log=str(tmp_path / "log"))) as cluster:
        kill = kill_once_there_is("shots/*/0003.json", folder, cluster)
        outcome = run_job(folder, SETTINGS, progress=kill, cluster=cluster)
        assert kill.killed
        assert not processes(cluster) & set(kill.killed)
        assert (outcome.complete, outcome.total) == (15, 15)
        assert content(folder) == whole
        shots = (tmp_path / "log").read_text().split()
        assert len(set(shots)) == 15
        assert len(shots) < 15 + 4  # all but what was lost with the worker were made once
        assert run_job(folder, SETTINGS, cluster=cluster) == Outcome(0, 15, 15)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes")
def test_a_full_disk_is_one_sentence_and_leaves_no_broken_shot(tmp_path, whole):
    folder = tmp_path / "c"
    said = start(folder, tmp_path / "log", 0.0, 3000).communicate()[0]
    assert said.startswith("Cannot write")
    assert "free some space" in said
    assert said.count("\n") == 1
    assert not list(folder.rglob(".grmm-*"))
    assert CaptureDataset(folder).shots == []
    run_job(folder, SETTINGS)
    assert content(folder) == whole


def test_only_some_people(tmp_path):
    assert run_job(tmp_path, SETTINGS, only=[1]) == Outcome(5, 5, 5)
    assert CaptureDataset(tmp_path).subjects == ["s0000_0001"]
    with pytest.raises(ConfigError, match=r"person 3 for --only; choose from 0 to 2"):
        run_job(tmp_path, SETTINGS, only=[3])


def test_what_others_hold_is_counted_and_taken_over_later(tmp_path):
    lock = tmp_path / "locks" / "s0000_0002_0000.lock"
    with claim(lock):
        outcome = run_job(tmp_path, SETTINGS)
    assert outcome == Outcome(11, 11, 15)
    assert outcome.in_work == 4
    assert run_job(tmp_path, SETTINGS) == Outcome(4, 15, 15)
    for record in list(tmp_path.glob("shots/*/*.json")):
        record.unlink()
    held = claim(lock)
    held.__enter__()

    def end_of_the_other(progress):
        if progress.message.startswith("11/15"):
            held.__exit__(None, None, None)

    assert run_job(tmp_path, SETTINGS, progress=end_of_the_other) == Outcome(15, 15, 15)


def test_progress_counts_the_shots_of_all(tmp_path):
    seen = []

    def report(progress):
        seen.append(progress)
        if len(seen) == 3:  # another process has been here
            for number in (2, 3):
                (tmp_path / "shots" / "s0000_0000" / f"{number:04d}.json").write_text("{}")

    run_job(tmp_path, SETTINGS, progress=report)
    check_progress(seen, CAPTURE)
    assert [round(15 * one.fraction) for one in seen] == [0, 1, 2, *range(5, 16)]
    assert seen[3].message.startswith("5/15 s0000_")
    assert all(Path(one.picture).suffix == ".png" and Path(one.picture).exists() for one in seen[1:])
    assert seen[-1].seconds_left == 0.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--cameras", "25"], "--cameras 25 is not possible; use 1 to 24"),
        (["--cameras", "0"], "--cameras 0 is not possible"),
        (["--seed", "-1"], "--seed -1 is not possible; use 0 or more"),
        (["--shots", "0"], "--shots"),
        (["--shots", "10001"], "--shots 10001 is not possible; use at most 10000"),
        (["--expressions", "grin"], "grin"),
        (["--only", "24"], "There is no person 24 for --only"),
        (["--threads", "0"], "--threads"),
    ],
)
def test_a_wrong_option_leaves_no_folder(tmp_path, monkeypatch, capsys, options, words):
    pretend_bpy(monkeypatch)
    folder = tmp_path / "c"
    assert main(["capture", str(folder), *options]) == 1
    said = capsys.readouterr().err
    assert words in said
    assert "Internal" not in said
    assert not folder.exists()


def test_other_settings_are_named_as_options(tmp_path):
    open_job(tmp_path, CaptureSettings(varied_light=True))
    for values, words in (
        ({"varied_light": True, "views": 5}, "with --cameras 4, not 5"),
        ({}, "with --varied-light;"),
        ({"varied_light": True, "subsurface": True}, "without --subsurface;"),
        ({"varied_light": True, "depth": False}, "without --no-depth;"),
    ):
        with pytest.raises(ConfigError, match=words):
            open_job(tmp_path, CaptureSettings(**values))
    assert check_settings(CaptureSettings(views=24))


def test_a_capture_of_another_studio_is_not_continued(tmp_path, monkeypatch):
    open_job(tmp_path, CaptureSettings())
    assert read_manifest(tmp_path).settings["studio"] == STUDIO
    path = tmp_path / "dataset.json"
    values = json.loads(path.read_text())
    del values["settings"]["studio"]
    path.write_text(json.dumps(values))
    with pytest.raises(ConfigError, match=f"studio 2, and this is studio {STUDIO}.*use another folder"):
        open_job(tmp_path, CaptureSettings())  # made before the number was recorded
    open_job(tmp_path / "new", CaptureSettings())
    monkeypatch.setattr(settings_module, "STUDIO", STUDIO + 1)
    with pytest.raises(ConfigError, match=f"studio {STUDIO}, and this is studio {STUDIO + 1}.*use another folder"):
        open_job(tmp_path / "new", CaptureSettings())


def pretend_bpy(monkeypatch):
    module = types.ModuleType("bpy")
    module.__spec__ = importlib.machinery.ModuleSpec("bpy", None)
    monkeypatch.setitem(sys.modules, "bpy", module)


def test_the_command_says_how_the_job_stands(tmp_path, monkeypatch, capsys):
    pretend_bpy(monkeypatch)
    command = ["capture", str(tmp_path), "--subjects", "2", "--shots", "2", "--cameras", "1", "--size", "24"]
    with claim(tmp_path / "locks" / "s0000_0001_0000.lock"):
        assert main(command) == 0
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith("2 of 4 shots are complete, 2 of them made now; other processes hold 2")
    assert main(command) == 0
    assert capsys.readouterr().err.splitlines()[-1] == "4 of 4 shots are complete, 2 of them made now."
    assert main([*command, "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values == {"folder": str(tmp_path), "shots": 0, "complete": 4, "total": 4, "in_work": 0}


def test_contact_sheet(tmp_path):
    target = tmp_path / "sheet.png"
    open_job(tmp_path / "empty", SETTINGS)
    with pytest.raises(ConfigError, match="no complete shot yet"):
        write_sheet(tmp_path / "empty", target)
    with pytest.raises(FileAccessError, match="does not exist"):
        write_sheet(tmp_path / "nothing", target)
    assert not target.exists()
    run_job(tmp_path / "c", SETTINGS)
    assert write_sheet(tmp_path / "c", target, columns=4, limit=10, tile=16) == 10
    with Image.open(target) as sheet:
        assert sheet.size == (64, 48)
    assert write_sheet(tmp_path / "c", target, tile=16) == 30


def test_layers_twins_and_lights_are_written_for_every_view(tmp_path):
    settings = replace(SETTINGS, subjects=1, shots=1, bare="all", layers=True, lights="key,sunset")
    run_job(tmp_path, settings)
    data = CaptureDataset(tmp_path)
    views = list(data.views())
    assert len(views) == 2
    for shot, view in views:
        assert set(view.layers) == set(view.bare.layers) == {PART_LAYER, ALBEDO, NORMAL, "light_key", "light_sunset"}
        assert data.layer(shot, view, PART_LAYER).shape == (len(PARTS), 40, 40)
        assert np.abs(data.picture(shot, view).rgb - data.picture(shot, view.bare).rgb).max() > 0.1
        assert np.abs(data.layer(shot, view, "light_key") - data.layer(shot, view, "light_sunset")).max() > 0.1
    with pytest.raises(ConfigError, match="'lava'"):
        run_job(tmp_path / "other", replace(settings, lights="lava"))
    assert not (tmp_path / "other").exists()


def test_views_of_some_splits_alone_are_the_same_views(tmp_path):
    whole = replace(SETTINGS, subjects=1, shots=8, views=8)
    held = replace(whole, splits="camera,expression")
    run_job(tmp_path / "whole", whole)
    outcome = run_job(tmp_path / "held", held)
    every, some = CaptureDataset(tmp_path / "whole"), CaptureDataset(tmp_path / "held")
    kept = [(shot.number, view.name) for shot, view in every.views(HELD_OUT_CAMERA, HELD_OUT_EXPRESSION)]
    assert [(shot.number, view.name) for shot, view in some.views()] == kept
    assert 0 < outcome.total < 8, "shots without such views are no work"
    assert run_job(tmp_path / "held", held).made == 0
    with pytest.raises(ConfigError, match="'test' for --splits"):
        run_job(tmp_path / "other", replace(whole, splits="test"))


def test_captures_of_before_a_setting_go_on_with_its_default(tmp_path):
    run_job(tmp_path, replace(SETTINGS, subjects=1, shots=1))
    manifest = json.loads((tmp_path / "dataset.json").read_text())
    del manifest["settings"]["splits"]
    (tmp_path / "dataset.json").write_text(json.dumps(manifest))
    assert run_job(tmp_path, replace(SETTINGS, subjects=1, shots=1)).complete == 1
    with pytest.raises(ConfigError, match="with --splits"):
        run_job(tmp_path, replace(SETTINGS, subjects=1, shots=1, splits="person"))


def test_after_the_neutral_shot_nothing_but_the_bare_head_is_rendered_where_that_is_asked_for(tmp_path):
    run_job(tmp_path, replace(SETTINGS, subjects=1, shots=2, bare="rest"))
    data = CaptureDataset(tmp_path)
    views = list(data.views())
    assert [view.only_bare for _, view in views] == [False, False, True, True]
    assert not list(tmp_path.rglob("0001_0[01].png"))
    for shot, view in views[2:]:
        assert view.bare is not None
        np.testing.assert_array_equal(data.picture(shot, view).rgb, data.picture(shot, view.bare).rgb)
    run_job(tmp_path / "bare", replace(SETTINGS, subjects=1, shots=1, bare="only"))
    alone = CaptureDataset(tmp_path / "bare")
    for (shot, view), (other, first) in zip(views[:2], alone.views(), strict=True):
        assert first.only_bare
        np.testing.assert_array_equal(data.picture(shot, view.bare).rgb, alone.picture(other, first).rgb)
    with pytest.raises(ConfigError, match="use all, rest or only"):
        run_job(tmp_path / "other", replace(SETTINGS, bare="half"))
