"""Trainings and captures that are killed, run out of disk, or meet bad data: nothing done before is lost."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from model_fixtures import ColoredSpheres, small_head

from grmm_core.cli import main
from grmm_core.data.dataset import CaptureDataset, write_manifest, write_shot, write_subject
from grmm_core.data.types import Manifest, Picture, Shot, View
from grmm_core.errors import ConfigError, FileAccessError
from grmm_core.training.checkpoint import tidy
from grmm_core.training.config import train_config
from grmm_core.training.metrics_log import METRICS
from grmm_core.training.trainer import CHECKPOINT, Trainer

SCRIPT_PATHS = [
    str(Path(__file__).parents[2] / "support"),
    str(Path(__file__).parent),
]  # of the tests' own modules, for child processes
SETTINGS = {
    "steps": 14, "warmup_steps": 3, "checkpoint_every": 3, "preview_every": 0, "evaluate_every": 0, "refine_from": 0.2,
    "crop_size": 32, "crop_share": 0.5, "ema_every": 2,
}  # fmt: skip
LOSSES = {"perceptual": 0.0, "alpha": 0.3, "depth": 0.1}
_TRAINING = """
import sys
sys.path[:0] = [{root!r}, *{tests!r}]
from model_fixtures import ColoredSpheres, small_head
from grmm_core.training.config import train_config
from grmm_core.training.trainer import Trainer
config = train_config({{"preset": "tiny"}}, {settings!r}, {losses!r})
Trainer(config, small_head(), ColoredSpheres(), {out!r}).run()
"""


@pytest.fixture(scope="module")
def head():
    return small_head()


def config(**settings):
    return train_config({"preset": "tiny"}, {**SETTINGS, **settings}, LOSSES)


def numbers(folder):
    lines = [json.loads(line) for line in (folder / METRICS).read_text().splitlines()]
    return {line["step"]: line["loss"] for line in lines}, len(lines)


def test_a_killed_training_resumes_to_the_same_losses(head, tmp_path, repository):
    whole = Trainer(config(), head, ColoredSpheres(), tmp_path / "whole")
    whole.start()
    begun = {name: value.detach().clone() for name, value in whole.parameters.items()}
    whole.run()
    out = tmp_path / "killed"
    tests = SCRIPT_PATHS
    script = _TRAINING.format(root=str(repository), tests=tests, settings=SETTINGS, losses=LOSSES, out=str(out))
    environment = {**os.environ, "OMP_NUM_THREADS": str(torch.get_num_threads())}
    child = subprocess.Popen([sys.executable, "-c", script], env=environment)
    stop_at = random.Random(time.time_ns()).randint(4, 11)  # another moment in every run, on purpose
    deadline = time.monotonic() + 200
    while time.monotonic() < deadline and child.poll() is None:
        if (out / METRICS).exists() and (out / METRICS).read_text().count("\n") >= stop_at:
            child.send_signal(signal.SIGKILL)
            break
        time.sleep(0.002)
    assert child.wait() == -signal.SIGKILL
    (out / ".grmm-half.tmp").write_bytes(b"half a checkpoint")
    with (out / METRICS).open("a") as file:
        file.write('{"step": 99, "lo')
    second = Trainer(config(), head, ColoredSpheres(), out)
    assert second.resume()
    assert 3 <= second.step_count < 14
    assert not list(out.glob("*.tmp"))
    second.run()
    expected, found = numbers(tmp_path / "whole"), numbers(out)
    assert found[1] == 14  # no step is listed twice
    assert found[0] == pytest.approx(expected[0], rel=1e-4)
    # Adam divides by the gradient's size, so single weights of tiny gradient follow the rounding of sums, which differs between
    # processes; a lost or stale moment moves a whole tensor by much more than a hundredth of its way
    for name, value in whole.parameters.items():
        way, difference = (float(d.detach().norm()) for d in (value - begun[name], second.parameters[name] - value))
        assert difference <= 0.01 * way + 1e-6, name


def test_numbers_after_the_checkpoint_are_forgotten(tmp_path):
    path = tmp_path / METRICS
    tidy(tmp_path, METRICS, 3)
    path.write_text('{"step": 1.0}\n{"step": 2.0}\n{"step": 3.0}\nnonsense\n{"step": 4')
    tidy(tmp_path, METRICS, 2)
    assert path.read_text() == '{"step": 1.0}\n{"step": 2.0}\n'


def test_a_full_disk_keeps_the_last_checkpoint(head, tmp_path):
    trainer = Trainer(config(), head, ColoredSpheres(), tmp_path)
    trainer.start()
    trainer.step()
    trainer.save()
    kept = (tmp_path / CHECKPOINT).read_bytes()
    trainer.step()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(kept) // 2, limits[1]))  # the system refuses to write more, as a full disk
    try:
        with pytest.raises(FileAccessError, match="free some space"):
            trainer.save()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / CHECKPOINT).read_bytes() == kept
    assert [path.name for path in tmp_path.iterdir()] == [CHECKPOINT]
    again = Trainer(config(), head, ColoredSpheres(), tmp_path)
    assert again.resume()
    assert again.step_count == 1


# --- captures --------------------------------------------------------------------------------------------------------

_CAPTURE = """
import sys
sys.path[:0] = [{root!r}, *{tests!r}]
from pathlib import Path
from test_training_interrupted import write_shots
write_shots(Path({out!r}), 400)
"""
SIZE = 96


def write_shots(folder, count, split="train"):
    from grmm_core.geometry.camera import Camera

    rng = np.random.default_rng(0)
    for number in range(count):
        camera = Camera.orbit(SIZE, SIZE)
        names = [(f"{number:04d}_{k:02d}.png", f"{number:04d}_{k:02d}_z.png") for k in range(2)]
        views = tuple(View(f"c{k:02d}", camera, image, depth, split) for k, (image, depth) in enumerate(names))
        zeros = np.zeros(60), np.zeros(100), np.zeros((5, 3))
        shot = Shot("ada", number, "mix", *zeros, views, folder / "shots" / "ada")
        mask = np.ones((SIZE, SIZE), np.float32)
        write_shot(folder, shot, [Picture(rng.random((SIZE, SIZE, 3), np.float32), mask, mask)] * 2)


def capture(folder):
    write_manifest(folder, Manifest("open_head", ["ada"]))
    write_subject(folder, "ada", np.zeros(300), {})
    return folder


def test_a_killed_capture_has_no_broken_picture(tmp_path, repository):
    folder = capture(tmp_path / "capture")
    script = _CAPTURE.format(root=str(repository), tests=SCRIPT_PATHS, out=str(folder))
    child = subprocess.Popen([sys.executable, "-c", script])
    deadline = time.monotonic() + 200
    while time.monotonic() < deadline and len(list(folder.glob("shots/ada/*.json"))) < 5:
        time.sleep(0.01)
    time.sleep(random.Random(time.time_ns()).random() * 0.1)
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    dataset = CaptureDataset(folder)
    assert 5 <= len(dataset.shots) < 400
    for shot, view in dataset.views():
        picture = dataset.picture(shot, view)
        assert picture.rgb.shape == (SIZE, SIZE, 3)
        assert picture.depth is not None
    assert dataset.shots[-1].number == len(dataset.shots) - 1


def train(folder, out, *more):
    arguments = ["train", "small", "--data", str(folder), "--out", str(out), "--set", "steps=2", "image_size=48", *more]
    return main(arguments)


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (lambda folder: (folder / "shots/ada/0000_00.png").write_bytes(b"no picture"), "0000_00.png is a damaged picture"),
        (lambda folder: (folder / "shots/ada/0000_01.png").unlink(), "0000_01.png does not exist"),
        (lambda folder: drop_camera(folder / "shots/ada/0000.json"), "0000.json is damaged"),
        (lambda folder: (folder / "subjects/ada.npy").write_bytes(b"x"), "ada.npy is damaged"),
        (lambda folder: (folder / "dataset.json").write_text('{"format": "other"}'), "not a capture data set"),
        (lambda folder: (folder / "dataset.json").unlink(), "no data set that is known here"),
    ],
)
def test_bad_data_is_one_clear_sentence(tmp_path, capsys, break_it, words):
    folder = capture(tmp_path / "capture")
    write_shots(folder, 1)
    break_it(folder)
    assert train(folder, tmp_path / "run") == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run" / CHECKPOINT).exists()


def drop_camera(record):
    values = json.loads(record.read_text())
    del values["views"][0]["camera"]
    record.write_text(json.dumps(values))


# --- mixed precision -------------------------------------------------------------------------------------------------


def test_mixed_precision_learns_and_leaves_geometry_alone(head, tmp_path):
    source = ColoredSpheres()
    settings = {"steps": 50, "checkpoint_every": 0, "crop_share": 0.0, "ema": 0.9}
    plain = Trainer(config(**settings), head, source, tmp_path / "plain")
    mixed = Trainer(config(**settings, precision="bfloat16"), head, source, tmp_path / "mixed")
    for trainer in (plain, mixed):
        trainer.start()
    view, background = source.load(0), np.zeros(3, np.float32)
    one, two = (trainer.cast.draw(view, background, True) for trainer in (plain, mixed))
    torch.testing.assert_close(one.mesh.vertices, two.mesh.vertices, rtol=0, atol=0)
    assert two.image.dtype == two.offsets.dtype == torch.float32
    assert not torch.equal(one.offsets, two.offsets)
    torch.testing.assert_close(one.offsets, two.offsets, rtol=0.05, atol=0.02)
    first = [trainer.step()["loss"] for trainer in (plain, mixed)]
    assert first[1] == pytest.approx(first[0], rel=0.02)
    before = mixed.evaluate(4)["val_psnr"]
    for trainer in (plain, mixed):
        trainer.run()
    expected, found = (trainer.evaluate(4)["val_psnr"] for trainer in (plain, mixed))
    assert found > before + 0.5
    assert found == pytest.approx(expected, abs=0.7)
    assert all(p.dtype == torch.float32 for p in mixed.parameters.values())
    with pytest.raises(ConfigError, match="float16"):
        config(precision="float16")
