"""The model without torch against the model with it, step by step, with random weights."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny_model import write_tiny_weights

from grmm_core.avatar import Avatar
from grmm_core.controls.frame import Controls
from grmm_core.inference.coarse_loops import enlarge, halve
from grmm_core.inference.loader import PlainLoader
from grmm_core.model import refine
from grmm_core.model.torch_loader import TorchLoader
from grmm_core.splat.types import RasterOutput

ATOL = 2e-6  # single precision, sums in another order
FORMS = {
    "tiny": {},
    "no residuals": {"residuals": False},
    "no features": {"features": 0},
    "no maps": {"mean_maps": False, "basis_maps": 0, "expression_maps": 0},
    "unfolded": {"refine_unshuffle": 1, "refine_channels": (6, 8, 10)},
    "early view": {"view_stage": 4},
    "focused": {"focus": True},
}


@pytest.fixture(scope="module", params=FORMS)
def pair(request, tmp_path_factory):
    path = write_tiny_weights(tmp_path_factory.mktemp("forms") / "form.safetensors", **FORMS[request.param])
    return TorchLoader(torch.device("cpu")).load(path, None), PlainLoader(1).load(path, None)


def frame(loaded, seed=0):
    """Inputs of a frame in which everything does something."""
    rng = np.random.default_rng(seed)
    model = loaded.model
    person = Avatar(
        name="a", head=None, weights=None, z_id=rng.normal(size=model.config.z_id).astype(np.float32),
        z_exp=np.zeros(model.config.z_exp, np.float32), shape=rng.normal(size=300).astype(np.float32),
    )  # fmt: skip
    values = {"jawOpen": 0.6, "mouthSmileLeft": 0.8, "neck.y": 0.3, "eyes.yaw": 0.2}
    return loaded.space.inputs(person, Controls().set_named(values))


def compare(one, two, atol=ATOL):
    np.testing.assert_allclose(np.asarray(one), two.detach().numpy(), atol=atol, rtol=1e-5)


def test_decoders_mesh_and_places(pair):
    reference, plain = pair
    inputs, view = frame(plain), np.array([0.6, 0.0, 0.8], np.float32)
    tensors = reference.model.tensors(inputs)
    with torch.no_grad():
        compare(plain.model.opacity(inputs.z_id), reference.model.opacity(tensors.z_id))
        offsets = reference.model.offsets(tensors.z_id, tensors.z_exp)
        compare(plain.model.offsets(inputs.z_id, inputs.z_exp), offsets)
        added = reference.model.expression_colors(tensors.z_id, tensors.z_exp)
        compare(plain.model.expression_colors(inputs.z_id, inputs.z_exp), added)
        for one, two in zip(
            plain.model.appearance(inputs.z_id, view),
            reference.model.appearance(tensors.z_id, torch.from_numpy(view)),
            strict=True,
        ):
            compare(one, two)
        mesh, wanted = plain.model.mesh(inputs), reference.model.mesh(tensors)
        compare(mesh.vertices, wanted.vertices)
        compare(mesh.displacement, wanted.displacement)
        assert np.abs(mesh.displacement).max() > 1e-5
        placed = plain.model.geometry(mesh.vertices, offsets.numpy())
        truth = reference.model.geometry(wanted.vertices, offsets)
        compare(placed.means, truth.means)
        compare(placed.scales, truth.scales)
        turned = np.abs((placed.quats * truth.quats.numpy()).sum(-1))  # q and -q are one rotation
        np.testing.assert_allclose(turned, 1.0, atol=1e-5)
        normals = reference.model.normals(wanted.vertices)
        compare(plain.model.normals(mesh.vertices), normals, atol=1e-4)


@pytest.mark.parametrize("coarse", [False, True])
@pytest.mark.parametrize("size", [(48, 64), (37, 51)])
def test_refinement(pair, coarse, size):
    reference, plain = pair
    rng, (height, width) = np.random.default_rng(1), size
    rgb, features = (
        rng.random((height, width, 3), np.float32),
        rng.random((height, width, plain.model.config.features), np.float32),
    )
    depth, alpha = 1.0 + rng.random(size, np.float32), rng.random(size, np.float32)
    tensors = [torch.from_numpy(part) for part in (rgb, alpha, depth)]
    for cover in (None, 0.5 * alpha):  # of the second, half of the change
        own = None if cover is None else torch.from_numpy(cover)
        with torch.no_grad():
            wanted = reference.model.refine(RasterOutput(*tensors, torch.from_numpy(features)), None, coarse, own)
        found = plain.model.refine(RasterOutput(rgb, alpha, depth, features), None, coarse, cover)
        compare(found, wanted, atol=1e-5)
        assert np.abs(found - rgb).max() > 0.01
    whole = plain.model.refine(RasterOutput(rgb, alpha, depth, features), None, coarse)
    compare(2.0 * (found - rgb), torch.from_numpy(whole - rgb), atol=1e-5)


def test_an_avatars_changes(pair):
    reference, plain = pair
    rng, inputs = np.random.default_rng(2), frame(plain)
    deltas = {"decoders.appearance_mean": rng.normal(size=(plain.model.gaussian_count, 3 + plain.model.config.features))}
    if plain.model.config.basis_maps:
        deltas["decoders.basis.position"] = rng.normal(size=(3, 3 * plain.model.gaussian_count))
    deltas["refinement.exit.bias"] = rng.normal(size=3 * plain.model.config.refine_unshuffle**2)
    deltas = {name: value.astype(np.float32) for name, value in deltas.items()}
    path = Path("a.grmm")
    wanted = TorchLoader(torch.device("cpu")).with_deltas(reference, deltas, path).model
    found = PlainLoader(1).with_deltas(plain, deltas, path).model
    tensors, view = reference.model.tensors(inputs), np.array([0.0, 0.0, 1.0], np.float32)
    with torch.no_grad():
        compare(found.appearance(inputs.z_id, view)[0], wanted.appearance(tensors.z_id, torch.from_numpy(view))[0])
        compare(found.offsets(inputs.z_id, inputs.z_exp), wanted.offsets(tensors.z_id, tensors.z_exp), 1e-5)
    before = plain.model.appearance(inputs.z_id, view)[0]
    assert np.abs(found.appearance(inputs.z_id, view)[0] - before).max() > 0.5  # and the plain model is as it was


def test_halves_and_doubles_are_those_of_torch():
    g = np.random.default_rng(3)
    picture, cover = g.random((7, 10, 7), np.float32), g.random((7, 10), np.float32)
    small = np.empty((4, 5, 7), np.float32)
    halve(picture[..., :3], picture[..., 3], picture[..., 4], picture[..., 5:], small, 0, 4)
    compare(small, refine.halved(torch.from_numpy(picture)))
    larger = np.empty((7, 10, 3), np.float32)
    enlarge(small[..., :3].copy(), small[..., 4], picture[..., :3], cover, np.float32(1e-6), larger, 0, 7)
    doubled = refine.doubled(torch.from_numpy(small), 7, 10).numpy()
    compare(larger, torch.from_numpy(picture[..., :3] + cover[..., None] * doubled[..., :3] / doubled[..., 4:5]))


def test_a_picture_needs_no_torch(tmp_path):
    """The whole way from a file to a picture, where importing torch fails."""
    path = write_tiny_weights(tmp_path / "tiny.safetensors")
    script = """
import sys
sys.modules["torch"] = None
from grmm_core.geometry.camera import Camera
from grmm_core.session import Instance, create_session
with create_session("local", weights=sys.argv[1], threads=1) as session:
    info = session.open("default")
    picture = session.render([Instance(info.id)], Camera.orbit(48, 48))
    print(session.status().engine, float(picture["alpha"].max()) > 0.9, sys.modules["torch"] is None)
"""
    root, command = Path(__file__).resolve().parents[3], [sys.executable, "-c", script, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=root, timeout=300, check=False)
    assert done.stdout.split() == ["plain", "True", "True"], done.stderr
