from __future__ import annotations

import json
import os
import pickle
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from model_fixtures import ColoredSpheres, small_head

from grmm_core.cli import main
from grmm_core.data.dataset import CaptureDataset, write_manifest, write_shot, write_subject
from grmm_core.data.layers import PART_LAYER, PARTS
from grmm_core.data.types import Manifest, Picture, Shot, View
from grmm_core.errors import ConfigError, FileFormatError, TrainingError
from grmm_core.files.tensorfile import write_tensors
from grmm_core.geometry.camera import Camera
from grmm_core.training.capture import CapturedViews, capture_views
from grmm_core.training.config import load_config, train_config
from grmm_core.training.losses import weights_from
from grmm_core.training.metrics_log import METRICS
from grmm_core.training.perceptual import MobileNetFeatures, VGG19Features, load_perceptual
from grmm_core.training.trainer import Trainer
from grmm_core.training.views import random_crop, shrink

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


def test_eyes_and_mouths_are_known_where_part_masks_are(folder):
    shot, view = CapturedViews([CaptureDataset(folder)])._items[0][2:]
    parts = np.zeros((len(PARTS), SIZE, SIZE), np.float32)
    parts[PARTS.index("teeth"), 10, 7], parts[PARTS.index("hair"), 2, 2] = 1.0, 1.0
    picture = Picture(np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32), None, {PART_LAYER: parts})
    write_shot(folder, replace(shot, views=(replace(view, depth="", layers={PART_LAYER: "0000_00_parts.png"}),)), [picture])
    source = open_views(folder, detail=True)
    masked, plain = (source.load(int(index)) for index in source.training)
    assert np.argwhere(masked.detail).tolist() == [[10, 7]]  # in so small a picture it does not grow
    assert plain.detail is None
    assert open_views(folder).load(int(source.training[0])).detail is None
    assert random_crop(masked, 16, np.random.default_rng(0)).detail.shape == (16, 16)
    assert shrink(masked, SIZE // 2).detail[5, 3] == 64


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


def test_people_are_trained_without_hair_where_the_capture_shows_them_so(folder):
    """One view with a twin, one that only shows the bare head."""
    rng = np.random.default_rng(5)
    pictures = [Picture(rng.random((SIZE, SIZE, 3)), np.ones((SIZE, SIZE)), None) for _ in range(2)]
    for number in (0, 1):
        bare = View("c00", Camera.orbit(SIZE, SIZE), f"{number:04d}_00_bare.png", "", "train")
        view = replace(bare, image=f"{number:04d}_00.png" if number == 0 else bare.image, bare=bare)
        shot = Shot("bo", number, "mix", np.zeros(60), np.zeros(100), np.zeros((5, 3)), (view,), folder / "shots" / "bo")
        write_subject(folder, "bo", np.zeros(300, np.float32), {})
        write_shot(folder, shot, [replace(pictures[0], bare=pictures[1]) if number == 0 else pictures[1]])
    haired, bare = open_views(folder, only="bo"), open_views(folder, only="bo", bare=True)
    assert (len(haired.training), len(bare.training)) == (1, 2)
    np.testing.assert_allclose(haired.load(0).image / 255, pictures[0].rgb, atol=0.005)
    for index in (0, 1):
        np.testing.assert_allclose(bare.load(index).image / 255, pictures[1].rgb, atol=0.005)
    assert len(open_views(folder, only="ada", bare=True).training) == 2  # views without a twin stay what they are


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
    from grmm_core.model.weights_file import read_info

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
    both = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--standalone", *command[1:]]
    both += ["--resume", "--set", "steps=7", "views_per_step=2"]
    both = subprocess.run(both, capture_output=True, text=True, check=False, timeout=300)
    assert json.loads(both.stdout)["steps"] == 7  # one object, not one of each process


def test_the_command_says_what_it_continues(folder, tmp_path, capsys):
    config = tmp_path / "c.toml"
    config.write_text('[model]\npreset = "tiny"\n[training]\nsteps = 1\npreview_every = 0\n[losses]\nperceptual = 0.0\n')
    arguments = ["train", str(config), "--data", str(folder), "--out", str(tmp_path / "run"), "--resume"]
    assert main(arguments) == 0
    assert "There is no checkpoint" in (said := capsys.readouterr().err)
    assert "starting anew" in said
    assert main([*arguments, "--set", "steps=2", "threads=1"]) == 0
    assert "Continuing after step 1, not as it began: steps 2 instead of 1.\n" in capsys.readouterr().err


def test_a_full_graphics_card_is_one_sentence(folder, tmp_path, capsys, monkeypatch):
    def full(*_):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB.")

    monkeypatch.setattr(Trainer, "run", full)
    assert main(["train", "small", "--data", str(folder), "--out", str(tmp_path / "run")]) == 1
    error = capsys.readouterr().err
    assert "graphics card has not enough memory" in error
    assert error.count("\n") == 1


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


def test_vgg19_from_a_file_of_torchvision(tmp_path):
    torch.manual_seed(0)
    state = VGG19Features().state_dict()
    convolutions = (0, 2, 5, 7, 10, 12, 14, 16, 19, 21, 23, 25)  # of torchvision's vgg19 up to the fourth block
    assert set(state) == {f"features.{i}.{kind}" for i in convolutions for kind in ("weight", "bias")}
    rest = {"features.28.weight": torch.zeros(2, 2, 3, 3), "classifier.0.weight": torch.zeros(3, 4)}
    torch.save({**state, **rest}, tmp_path / "vgg19.pth")
    write_tensors(tmp_path / "vgg19.safetensors", {name: value.numpy() for name, value in {**state, **rest}.items()})
    a, b = torch.rand(33, 40, 3), torch.rand(33, 40, 3)
    values = []
    for name in ("vgg19.pth", "vgg19.safetensors"):
        distance = load_perceptual(f"vgg19:{tmp_path / name}")
        assert distance.name == "vgg19"
        for key, value in distance.features.state_dict().items():
            assert torch.equal(value, state[key])
        assert float(distance(a, a)) == 0.0
        values.append(float(distance(a, b)))
    assert 0.0 < values[0] == values[1] < 2.0


def test_mobilenet_from_its_package():
    distance = load_perceptual("mobilenet")
    assert distance.name == "mobilenet_v2"
    rows, columns = torch.meshgrid(torch.linspace(0, 1, 64), torch.linspace(0, 1, 64), indexing="ij")
    picture = torch.stack([rows, columns, 1 - rows], -1)
    darker, noise = picture * 0.95, torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0))
    assert 0.0 < float(distance(picture, darker)) < 0.5 * float(distance(picture, noise))


def test_training_with_the_papers_loss_weights(network, tmp_path):
    paper = load_config("paper").losses
    weights = weights_from(dict(paper))
    assert (weights.perceptual, weights.depth) == (0.04, 0.5)
    settings = {"steps": 2, "preview_every": 0, "evaluate_every": 0, "perceptual_network": f"mobilenet:{network}"}
    Trainer(train_config({"preset": "tiny"}, settings, paper), small_head(), ColoredSpheres(), tmp_path).run()
    rows = [json.loads(line) for line in (tmp_path / METRICS).read_text().splitlines()]
    assert len(rows) == 2
    for row in rows:
        assert min(row[name] for name in ("raw_perceptual", "image_perceptual", "depth")) > 0.0
        pictures = [(f"{picture}_{name}", name) for picture in ("raw", "image") for name in ("l1", "ssim", "perceptual")]
        others = [(name, name) for name in ("depth", "scale", "code", "laplacian")]
        total = sum(row[term] * getattr(weights, weight) for term, weight in pictures + others)
        assert row["loss"] == pytest.approx(total, rel=1e-4)


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
        Trainer(train_config({"preset": "tiny"}, {}, {}), small_head(), ColoredSpheres(), tmp_path)


# --- several processes -----------------------------------------------------------------------------------------------

SCRIPT_PATHS = [str(Path(__file__).parents[2] / "support")]  # of the tests' own modules, for child processes
_PROCESS = """
import sys
import torch
from pathlib import Path
sys.path[:0] = [{root!r}, *{tests!r}]
from model_fixtures import ColoredSpheres, small_head
from grmm_core.errors import CancelledError, ConfigError
from grmm_core.training.config import train_config
from grmm_core.training.processes import join
from grmm_core.training.trainer import Trainer
from grmm_core.training.views import random_crop, shrink
rank, world = join("cpu")
folder = Path({out!r}) / str(world)
def trainer(folder, **settings):
    quiet = {{"preview_every": 0, "checkpoint_every": 0, "evaluate_every": 0, "views_per_step": 2}}
    config = train_config({{"preset": "tiny"}}, {{"steps": 4, **quiet, **settings}}, {{"perceptual": 0.0, "alpha": 0.3}})
    return Trainer(config, small_head(), ColoredSpheres(32), folder, backend="torch")
one = trainer(folder)
said = []
try:
    one.run(cancelled=lambda: rank == world - 1 and one.step_count == 3)  # the last process alone is asked to stop
except CancelledError:
    said.append("stopped")
if rank == 0:
    torch.save({{k: v.detach() for k, v in one.parameters.items()}}, folder / "result.pt")
try:
    trainer(folder / "following", refresh_every=2)
except ConfigError as error:
    said.append(str(error))
(folder / f"said{{rank}}.txt").write_text("\\n".join(said))
if world > 1:
    torch.distributed.destroy_process_group()
"""


def free_port() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return str(listener.getsockname()[1])


def test_two_processes_do_what_one_does(tmp_path, repository):
    script = tmp_path / "run.py"
    script.write_text(_PROCESS.format(root=str(repository), tests=SCRIPT_PATHS, out=str(tmp_path)))
    shared = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": free_port()}  # as torchrun sets them
    places = ({}, {**shared, "RANK": "0"}, {**shared, "RANK": "1"})
    environments = [{**os.environ, "OMP_NUM_THREADS": "1", **place} for place in places]
    children = [subprocess.Popen([sys.executable, str(script)], env=environment) for environment in environments]
    try:
        assert [child.wait(timeout=300) for child in children] == [0, 0, 0]
    finally:
        for child in children:
            child.kill()
    one, two = (torch.load(tmp_path / str(n) / "result.pt", weights_only=True) for n in (1, 2))
    for name, value in one.items():
        torch.testing.assert_close(two[name], value, rtol=1e-4, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}")
    one, two = ([json.loads(line) for line in (tmp_path / str(n) / METRICS).read_text().splitlines()] for n in (1, 2))
    assert len(one) == len(two) == 3
    for alone, shared in zip(one, two, strict=True):
        assert alone.keys() == shared.keys()
        for name in alone.keys() - {"seconds"}:
            assert shared[name] == pytest.approx(alone[name], rel=1e-3, abs=2e-6), name
    assert (tmp_path / "1" / "said0.txt").read_text() == "stopped"
    for rank in (0, 1):
        stopped, refused = (tmp_path / "2" / f"said{rank}.txt").read_text().splitlines()
        assert stopped == "stopped"
        assert "--follow" in refused


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
