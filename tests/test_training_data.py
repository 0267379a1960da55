from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch
from model_fixtures import ColouredSpheres, small_head

from grmm_core.camera import Camera
from grmm_core.data.dataset import Manifest, Picture, Shot, View, write_manifest, write_shot, write_subject
from grmm_core.errors import ConfigError, FileFormatError, TrainingError
from grmm_core.tensorfile import write_tensors
from grmm_core.training.capture import CapturedViews, capture_views
from grmm_core.training.config import train_config
from grmm_core.training.perceptual import MobileNetFeatures, load_perceptual
from grmm_core.training.trainer import METRICS, Trainer

SIZE = 24


def write_person(folder, name, shots, split="train", shape=0.5):
    write_subject(folder, name, np.full(300, shape, np.float32), {})
    for number in shots:
        rng = np.random.default_rng(number)
        mask, depth = np.ones((SIZE, SIZE), np.float32), np.full((SIZE, SIZE), 1.1, np.float32)
        picture = Picture(rng.random((SIZE, SIZE, 3)).astype(np.float32), mask, depth)
        views = (View("c00", Camera.orbit(SIZE, SIZE), f"{number:04d}_00.png", f"{number:04d}_00_z.png", split),)
        aligned, expression, pose = np.zeros(60), np.zeros(100), np.zeros((5, 3))
        shot = Shot(name, number, "mix", aligned, expression, pose, views, folder / "shots" / name)
        write_shot(folder, shot, [picture])


@pytest.fixture
def folder(tmp_path):
    target = tmp_path / "capture"
    write_manifest(target, Manifest("open_head", ["ada", "bo", "cy"], {}, ["cy"]))
    write_person(target, "ada", [0, 1])
    write_person(target, "ada", [2], split="expression")
    write_person(target, "cy", [0], split="person")
    return target


def open_views(folder, **options):
    from grmm_core.data.dataset import CaptureDataset

    return CapturedViews([CaptureDataset(folder)], **options)


def test_captured_views(folder):
    source = open_views(folder)
    assert source.people == ("ada",)
    assert (len(source.training), len(source.validation)) == (2, 1)
    view = source.load(int(source.training[1]))
    assert view.image.shape == (SIZE, SIZE, 3)
    assert view.image.dtype == view.mask.dtype == np.uint8
    np.testing.assert_allclose(view.image / 255, np.random.default_rng(1).random((SIZE, SIZE, 3)), atol=0.005)
    np.testing.assert_allclose(view.depth, 1.1, atol=1e-4)
    assert source.shapes[view.subject, 0] == 0.5
    assert source.load(int(source.validation[0])).split == "expression"


def test_a_running_capture_is_followed(folder):
    source = open_views(folder, follow=True)
    assert source.people == ("ada", "bo")
    first = source.load(0)
    write_person(folder, "bo", [0, 1, 2], shape=-1.0)
    assert source.refresh() == 6
    assert len(source.training) == 5
    assert source.load(0) is first
    new = source.load(int(source.training[-1]))
    assert source.people[new.subject] == "bo"
    np.testing.assert_array_equal(source.shapes[:, 0], [0.5, -1.0])
    np.testing.assert_array_equal(source.subjects[source.training], [0, 0, 1, 1, 1])


def test_memory_for_pictures_is_bounded(folder):
    one = SIZE * SIZE * 8
    source = open_views(folder, cache_bytes=2 * one)
    for index in (0, 1, 2, 0):
        assert source.load(index).image.shape == (SIZE, SIZE, 3)
        assert sum(v.image.nbytes + v.mask.nbytes + v.depth.nbytes for v in source._cache.values()) <= 2 * one


def test_unusable_captures_are_explained(folder, tmp_path):
    (folder / "shots" / "ada" / "0000_00.png").write_bytes(b"no picture")
    source = open_views(folder)
    with pytest.raises(FileFormatError, match=r"0000_00\.png"):
        source.load(0)
    write_manifest(tmp_path / "other", Manifest("flame2023", ["ada"]))
    write_person(tmp_path / "other", "ada", [0])
    with pytest.raises(ConfigError, match="flame2023"):
        capture_views([tmp_path / "other"])
    write_manifest(tmp_path / "empty", Manifest("open_head", ["ada"]))
    with pytest.raises(TrainingError, match="no training views"):
        capture_views([tmp_path / "empty"])


def test_people_without_pictures_are_not_in_the_weights(folder, tmp_path):
    from grmm_core.head import load_open_head
    from grmm_core.model.weights import read_info

    source = open_views(folder, follow=True)
    config = train_config({"preset": "tiny"}, {"steps": 1}, {"perceptual": 0.0})
    trainer = Trainer(config, load_open_head(), source, tmp_path / "run")
    trainer.step()
    trainer.save_weights(tmp_path / "w.safetensors", {})
    assert read_info(tmp_path / "w.safetensors").people == ("ada",)


@pytest.mark.slow
def test_command_trains_stops_and_resumes(folder, tmp_path):
    config = tmp_path / "c.toml"
    config.write_text(
        '[model]\npreset = "tiny"\n[training]\nname = "mine"\nsteps = 4\ncheckpoint_every = 1\nevaluate_every = 2\n'
        "preview_every = 0\n[losses]\nperceptual = 0.0\n"
    )
    out = tmp_path / "run"
    command = [sys.executable, "-m", "grmm_core", "train", str(config), "--data", str(folder), "--out", str(out), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["steps"] == 4
    assert (out / "mine.safetensors").exists()
    again = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert again.returncode == 1
    assert "--resume" in again.stderr
    longer = [*command, "--resume", "--set", "steps=6"]
    longer = subprocess.run(longer, capture_output=True, text=True, check=False, timeout=300)
    assert json.loads(longer.stdout)["steps"] == 6
    assert len((out / METRICS).read_text().splitlines()) == 6


# --- perceptual ------------------------------------------------------------------------------------------------------


@pytest.fixture
def network(tmp_path):
    torch.manual_seed(0)
    path = tmp_path / "net.safetensors"
    write_tensors(path, {name: value.numpy() for name, value in MobileNetFeatures().state_dict().items()})
    return path


def test_perceptual_distance(network):
    distance = load_perceptual(f"mobilenet:{network}")
    a = torch.rand(40, 33, 3)
    near, far = a.clone(), torch.rand(40, 33, 3)
    near[:8] += 0.05
    assert float(distance(a, a)) == 0.0
    assert 0.0 < float(distance(a, near)) < float(distance(a, far)) < 2.0
    a.requires_grad_(True)
    distance(a, far).backward()
    assert a.grad.abs().sum() > 0
    assert not any(p.requires_grad for p in distance.parameters())


def test_perceptual_networks_that_cannot_be_used(network, tmp_path):
    with pytest.raises(FileFormatError, match="expected network"):
        load_perceptual(f"vgg19:{network}")
    with pytest.raises(ConfigError, match="lpips"):
        load_perceptual("lpips")

    class Evil:
        def __reduce__(self):
            return (os.system, (f"touch {tmp_path}/ran",))

    (tmp_path / "evil.pth").write_bytes(pickle.dumps(Evil()))
    with pytest.raises(FileFormatError):
        load_perceptual(f"vgg19:{tmp_path}/evil.pth")
    assert not (tmp_path / "ran").exists()
    with pytest.raises(ConfigError, match="perceptual_network"):
        Trainer(train_config({"preset": "tiny"}, {}, {}), small_head(), ColouredSpheres(), tmp_path)


# --- several processes -----------------------------------------------------------------------------------------------

_PROCESS = """
import sys, torch
sys.path[:0] = [{root!r}, {tests!r}]
from model_fixtures import ColouredSpheres, small_head
from grmm_core.training.config import train_config
from grmm_core.training.trainer import Trainer
config = train_config({{"preset": "tiny"}}, {{"steps": 3, "views_per_step": 2, "preview_every": 0, "checkpoint_every": 0,
    "evaluate_every": 0}}, {{"perceptual": 0.0, "alpha": 0.3}})
trainer = Trainer(config, small_head(), ColouredSpheres(), {out!r}, backend="torch")
trainer.run()
if trainer.rank == 0:
    torch.save({{k: v.detach() for k, v in trainer.parameters.items()}}, {out!r} + f"/result{{trainer.world}}.pt")
"""


@pytest.mark.slow
def test_two_processes_do_what_one_does(tmp_path, repository):
    script = tmp_path / "run.py"
    script.write_text(_PROCESS.format(root=str(repository), tests=str(repository / "tests"), out=str(tmp_path)))
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, str(script)], check=True, timeout=300, env=environment)
    launch = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--master-port", "29517", str(script)]
    subprocess.run(launch, check=True, timeout=300, env=environment)
    one, two = (torch.load(tmp_path / f"result{n}.pt", weights_only=True) for n in (1, 2))
    for name, value in one.items():
        torch.testing.assert_close(two[name], value, rtol=1e-4, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}")


def test_each_process_has_a_card_of_its_own(monkeypatch):
    from grmm_core.cli.train import _device

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert _device("auto") == _device("cuda") == "cuda"
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert _device("auto") == _device("cuda") == "cuda:1"
    assert _device("cpu") == "cpu"
    assert _device("cuda:0") == "cuda:0"


def test_settings_of_the_command_line():
    from grmm_core.cli.train import _settings

    values = _settings(["steps=3", "ema=0.5", "tensorboard=true", "init_from=a/b.safetensors", "name=x=y"])
    assert values == {"steps": 3, "ema": 0.5, "tensorboard": True, "init_from": "a/b.safetensors", "name": "x=y"}
    with pytest.raises(ConfigError, match="NAME=VALUE"):
        _settings(["steps"])
