"""Splat clouds from elsewhere, drawn by a session beside its avatars."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

from grmm_core.controls.frame import Controls
from grmm_core.errors import SessionError, ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.session import CloudArrays, Instance, RenderOptions, create_session
from grmm_core.session.harmonics import harmonic_basis

SIZE = 96
CAMERA = Camera.orbit(SIZE, SIZE)
SAME = {"rtol": 0.0, "atol": 2e-3}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture(scope="module", params=[("local", "torch"), ("worker", "plain")], ids=["torch", "plain"])
def session(request, weights):
    mode, engine = request.param
    with create_session(mode, weights=weights, device="cpu", threads=1, engine=engine) as session:
        yield session


def ball(count: int = 2000, terms: int = 1, seed: int = 1, radius: float = 0.08) -> CloudArrays:
    generator = np.random.default_rng(seed)
    means = generator.normal(size=(count, 3))
    means *= radius / np.linalg.norm(means, axis=1, keepdims=True)
    harmonics = generator.normal(0, 0.3, (count, terms, 3))
    quats = generator.normal(size=(count, 4))
    scales = np.full((count, 3), 0.004)
    return CloudArrays(means, quats / np.linalg.norm(quats, axis=1, keepdims=True), scales, np.full(count, 0.95), harmonics)


def draw(session, instances, passes=("rgb", "alpha"), **options):
    return session.render(instances, CAMERA, RenderOptions(passes=passes, **options))


def test_an_avatars_own_gaussians_come_back_as_the_same_picture(session):
    avatar = session.open("default")
    wanted = draw(session, [Instance(avatar.id)], ("raw", "alpha", "depth"))
    found = session.gaussians(avatar.id, Controls(), CAMERA.view_direction(np.zeros(3)))
    harmonics = (found.colors[:, None] - 0.5) / harmonic_basis(np.array([[0.0, 0.0, 1.0]]), 0)[0, 0]
    cloud = session.put_cloud(
        "copy", "1", CloudArrays(found.means, found.quats, found.scales, found.opacities.clip(0, 1), harmonics)
    )
    drawn = draw(session, [Instance(cloud)], ("rgb", "raw", "alpha", "depth"))
    np.testing.assert_allclose(drawn["alpha"], wanted["alpha"], **SAME)
    np.testing.assert_allclose(drawn["raw"], wanted["raw"], rtol=0.0, atol=0.02)
    np.testing.assert_array_equal(drawn["rgb"], drawn["raw"])  # no network touches it


def test_colors_follow_the_direction_of_view(session):
    one = ball(1, terms=4)
    one.means[:] = 0.0
    one.scales[:] = 0.05
    one.opacities[:] = 1.0
    number = session.put_cloud("single", "1", one)
    for yaw in (0.0, 90.0, 200.0):
        camera = Camera.orbit(33, 33, yaw=yaw)
        pixel = session.render([Instance(number)], camera, RenderOptions(passes=("rgb", "alpha")))
        basis = harmonic_basis(-camera.position[None] / np.linalg.norm(camera.position), 1)[0]
        wanted = np.clip(0.5 + basis @ one.harmonics[0], 0, None)
        np.testing.assert_allclose(pixel["rgb"][16, 16] / pixel["alpha"][16, 16], wanted, atol=1e-3)


def test_turning_a_cloud_turns_its_harmonics(session):
    """A cloud that turns with the camera looks the same."""
    number = session.put_cloud("turned", "1", ball(terms=16))
    angle = 0.7
    turn = np.eye(4)
    turn[0, 0], turn[0, 2], turn[2, 0], turn[2, 2] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    still = draw(session, [Instance(number)])
    camera = CAMERA.transformed(np.linalg.inv(turn))
    moved = session.render([Instance(number, model_to_world=turn)], camera, RenderOptions(passes=("rgb", "alpha")))
    np.testing.assert_allclose(moved["rgb"], still["rgb"], **SAME)


def test_versions_replace_and_ids_stay(session):
    first = session.put_cloud("changing", "1", ball(seed=1))
    before = draw(session, [Instance(first)])
    assert session.put_cloud("changing", "1", ball(seed=2)) == first  # the same version: not looked at
    np.testing.assert_allclose(draw(session, [Instance(first)])["rgb"], before["rgb"], atol=1e-5)
    assert session.put_cloud("changing", "2", ball(seed=2)) == first
    assert np.abs(draw(session, [Instance(first)])["rgb"] - before["rgb"]).max() > 0.05
    assert session.put_cloud("another", "1", ball()) != first
    session.release(first)
    with pytest.raises(SessionError, match="no avatar"):
        draw(session, [Instance(first)])


def test_refinement_leaves_clouds_alone(session):
    avatar = session.open("default")
    cloud = session.put_cloud("beside", "1", ball())
    aside = np.eye(4)
    aside[0, 3] = 0.3
    camera = Camera.orbit(160, 96, distance=1.6)
    options = RenderOptions(passes=("rgb", "raw", "alpha", "mask", "normal"))
    both = session.render([Instance(avatar.id), Instance(cloud, model_to_world=aside)], camera, options)
    only = both["mask"][..., 1] > 0.999
    assert only.sum() > 50
    np.testing.assert_allclose(both["rgb"][only], both["raw"][only], atol=1e-5)
    assert not both["normal"][only].any()
    head = both["mask"][..., 0] > 0.9
    assert np.abs(both["rgb"][head] - both["raw"][head]).max() > 0.01
    alone = session.render([Instance(avatar.id)], camera, options)
    np.testing.assert_allclose(both["rgb"][head], alone["rgb"][head], atol=5e-3)


def test_less_detail_keeps_the_cover(session):
    number = session.put_cloud("dense", "1", ball(8000, terms=4))
    full, less = (draw(session, [Instance(number)], lod=lod)["alpha"] for lod in (0, 1))
    assert less[full > 0.999].min() > 0.8  # no holes
    assert less.mean() < 1.3 * full.mean()


def test_shapes_are_checked():
    good = ball(5)
    with pytest.raises(ShapeError, match="quats"):
        CloudArrays(good.means, good.quats[:, :3], good.scales, good.opacities, good.harmonics)
    with pytest.raises(ShapeError, match="harmonics"):
        CloudArrays(good.means, good.quats, good.scales, good.opacities, good.harmonics[:, :, 0])
    with pytest.raises(ShapeError, match="9 or 16"):
        CloudArrays(good.means, good.quats, good.scales, good.opacities, np.zeros((5, 5, 3)))


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="sends POSIX signals")
def test_a_new_worker_gets_the_clouds_again(weights):
    with create_session("worker", weights=weights, device="cpu", threads=1) as session:
        number = session.put_cloud("kept", "1", ball())
        before = draw(session, [Instance(number)])
        os.kill(session.status().pid, signal.SIGKILL)
        while session.status().alive:
            pass
        np.testing.assert_allclose(draw(session, [Instance(number)])["rgb"], before["rgb"], atol=1e-6)
