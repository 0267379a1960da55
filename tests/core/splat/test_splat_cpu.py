"""The compiled CPU rasteriser against its readable twin: pictures and gradients, on ordinary and on degenerate scenes."""

from __future__ import annotations

import dataclasses
import threading

import numba
import numpy as np
import pytest
import torch
from splat_scenes import NAMES, OUTPUTS, SCENES, assert_parity, leaves_of, orbit, pulled, scene

from grmm_core.geometry.camera import Camera
from grmm_core.splat import Gaussians, rasterize
from grmm_core.splat.cpu import jit, threads


def draw(gaussians, camera, backend, dtype, antialiased, background):
    leaves = leaves_of(gaussians, dtype)
    return pulled(rasterize(Gaussians(*leaves), camera, background, backend, antialiased), leaves)


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("name", SCENES)
def test_pictures_and_gradients_equal_the_reference(name, antialiased):
    make, camera = SCENES[name]
    expected = draw(make(), camera, "torch", torch.float64, antialiased, (0.2, 0.5, 0.7))
    assert expected[0][1].max() > 0, "the scene must show something"
    assert_parity(draw(make(), camera, "cpu", torch.float32, antialiased, (0.2, 0.5, 0.7)), expected)


def test_gradients_of_one_output_alone_equal_the_reference():
    camera = orbit(30, 30)
    for output in OUTPUTS:
        gradients = []
        for backend, dtype in (("torch", torch.float64), ("cpu", torch.float32)):
            many = scene(60, seed=21, dtype=dtype)
            many.means.requires_grad_()
            picture = getattr(rasterize(many, camera, backend=backend), output)
            weights = torch.linspace(-1, 1, picture.numel(), dtype=dtype).reshape(picture.shape)
            gradients.append(torch.autograd.grad((picture * weights).sum(), many.means)[0].double())
        torch.testing.assert_close(gradients[1], gradients[0], rtol=1e-3, atol=2e-4 * gradients[0].abs().max().item())


def test_the_picture_does_not_depend_on_gradients_threads_or_layout(monkeypatch):
    many, camera = scene(3000, seed=22), orbit(100, 90)
    expected = rasterize(many, camera)
    monkeypatch.setattr(threads, "thread_count", lambda: 1)
    single = rasterize(many, camera)
    monkeypatch.setattr(threads, "thread_count", lambda: 5)
    scattered = {name: getattr(many, name).repeat_interleave(2, 0)[::2] for name in NAMES}
    strided = rasterize(Gaussians(**scattered), camera)
    many.means.requires_grad_()
    learning = rasterize(many, camera)
    for other in (single, strided, learning):
        for name in OUTPUTS:
            assert torch.equal(getattr(other, name).detach(), getattr(expected, name))
    assert learning.rgb.requires_grad
    assert not expected.rgb.requires_grad


def test_gradients_are_the_same_every_time():
    def gradients():
        return draw(scene(3000, seed=23), orbit(100, 90), "cpu", torch.float32, False, None)[1]

    for first, second in zip(gradients(), gradients(), strict=True):
        assert torch.equal(first, second)


def test_several_threads_may_draw_at_a_time():
    scenes = [scene(500, seed=30 + k) for k in range(4)]
    expected = [rasterize(one, orbit(90, 70)).rgb for one in scenes]
    results = {}

    def work(k):
        for _ in range(5):
            results[k] = rasterize(scenes[k], orbit(90, 70)).rgb

    workers = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for k in range(4):
        assert torch.equal(results[k], expected[k])


def test_an_error_in_a_task_reaches_the_caller(monkeypatch):
    monkeypatch.setattr(threads, "thread_count", lambda: 3)

    def call(task):
        if task == 7:
            raise ValueError("task 7")

    with pytest.raises(ValueError, match="task 7"):
        threads.for_each(20, call)


def test_the_pool_grows_with_the_number_of_threads(monkeypatch):
    together = []
    for count in (2, 4):
        monkeypatch.setattr(threads, "thread_count", lambda count=count: count)
        barrier = threading.Barrier(count, timeout=60)
        threads.for_each(count, lambda task, barrier=barrier: together.append(barrier.wait()))
    assert sorted(together) == [0, 0, 1, 1, 2, 3]


def test_kernels_compile_where_no_folder_can_be_written(monkeypatch):
    compile_function = numba.njit

    def refuse(**options):
        if options["cache"]:
            raise RuntimeError("cannot cache function: no locator available")
        return compile_function(**options)

    monkeypatch.setattr(numba, "njit", refuse)

    @jit.kernel
    def double(x):
        return 2 * x

    assert double(21) == 42


def test_inputs_may_be_of_another_float_type():
    many = scene(50, seed=24, dtype=torch.float64)
    many.colors.requires_grad_()
    out = rasterize(many, orbit(), backend="cpu")
    assert out.rgb.dtype == torch.float32
    out.rgb.sum().backward()
    assert many.colors.grad.dtype == torch.float64


def test_a_picture_wider_than_the_tile_grid_is_refused():
    from grmm_core.errors import BackendError

    with pytest.raises(BackendError, match="too large"):
        rasterize(scene(1), Camera(np.eye(4), 1.0, 1.0, 0.0, 0.0, 1 << 19, 1), backend="cpu")


def test_gaussians_that_would_fill_the_memory_are_refused(monkeypatch):
    """Each of them covers all tiles; a hostile file can hold millions."""
    from grmm_core.errors import BackendError
    from grmm_core.splat.cpu import function

    many = scene(50, seed=9, size=3.0)
    many.means.requires_grad_()
    monkeypatch.setattr(function, "MAX_GRADIENT_BYTES", 1000)
    out = rasterize(many, orbit(), backend="cpu")
    with pytest.raises(BackendError, match="too large and too many to differentiate"):
        out.rgb.sum().backward()
    monkeypatch.setattr(function, "MAX_INSTANCES", 100)
    with pytest.raises(BackendError, match="too large and too many to draw"):
        rasterize(many, orbit(), backend="cpu")


def test_blocks_are_found_exactly():
    """Against every pixel of the tile: no block that a Gaussian reaches is missed, and few others are listed."""
    from grmm_core.splat.cpu import blocks
    from grmm_core.splat.cpu.projection import REACH, SQUEEZE, VALUES

    rng = np.random.default_rng(31)
    count, listed, reached = 400, 0, 0
    places = np.zeros((blocks.BATCH, VALUES), np.float32)
    pairs = np.empty((blocks.BATCH + 1) * blocks.BLOCKS, np.int32)
    first = np.empty(blocks.BATCH + 1, np.int64)
    for _ in range(count):
        places[0, :2] = rng.uniform(-30, 60, 2)
        places[0, 2], places[0, 4] = np.exp(rng.uniform(-4, 0.6, 2))  # from round to needles
        places[0, 3] = rng.normal() * places[0, 2]
        places[0, REACH] = SQUEEZE**2 * rng.uniform(0.5, 11.0)
        found = blocks.find_blocks(1, places, np.float32(16), np.float32(0), pairs, first)
        x, y = np.meshgrid(np.arange(16) + 16.5 - places[0, 0], np.arange(16) + 0.5 - places[0, 1])
        s, q = places[0, 2] * x + places[0, 3] * y, places[0, 4] * y
        inside = SQUEEZE**2 * (s * s + q * q) <= places[0, REACH] * (1 - 1e-5)
        number = np.arange(16)[:, None] // blocks.BLOCK_Y * blocks.BLOCKS_X + np.arange(16) // blocks.BLOCK_X
        wanted = set(np.unique(number[inside]).tolist())
        assert wanted <= set(pairs[:found].tolist())
        assert len(set(pairs[:found].tolist())) == found
        listed, reached = listed + found, reached + len(wanted)
    assert reached > 500
    assert listed < 1.2 * reached


def test_work_is_counted():
    from grmm_core.splat.cpu import count, function
    from grmm_core.splat.rules import View

    many, camera = scene(200, seed=32), orbit()
    inputs = [getattr(many, name).numpy() for name in NAMES]
    _, drawing = function.draw(inputs, np.zeros((1, 1, 3), np.float32), View.of(camera), False)
    work = count.count_work(drawing, camera.width, camera.height)
    # By the reference, with a feature of its own for each Gaussian: blended where that is above zero.
    marked = dataclasses.replace(many, features=torch.eye(200))
    expected = int((rasterize(marked, camera, backend="torch").features > 0).sum())
    assert work.needed == pytest.approx(expected, rel=1e-3)
    assert work.needed < work.blended <= work.evaluated < work.instances * 256


def test_memory_of_dropped_pictures_is_used_again_and_held_pictures_are_left_alone():
    from grmm_core.splat.cpu import buffers

    camera = orbit(300, 260)
    many = scene(200, channels=8, seed=33)
    first = rasterize(many, camera)
    held = first.features[100:110, ::3]  # a view alone must keep the memory
    before, place = held.clone(), first.features.data_ptr()
    del first
    second = rasterize(scene(300, channels=8, seed=34), camera)
    assert second.features.data_ptr() != place
    assert torch.equal(held, before)
    del held
    kept = buffers.kept_bytes()
    assert kept >= second.features.numel() * 4
    third = rasterize(scene(0, channels=8), camera, background=(0.1, 0.2, 0.3))
    assert third.features.data_ptr() == place
    assert buffers.kept_bytes() < kept
    for tensor in (third.alpha, third.depth, third.features):  # what was drawn there before is gone
        assert tensor.abs().max() == 0
    torch.testing.assert_close(third.rgb, torch.tensor([0.1, 0.2, 0.3]).expand(260, 300, 3))


def test_kept_memory_is_bounded(monkeypatch):
    from grmm_core.splat.cpu import buffers

    monkeypatch.setattr(buffers, "KEPT_BYTES", 3 << 20)
    held = [buffers.empty((1 << 18,)) for _ in range(6)]
    del held
    assert buffers.kept_bytes() <= 3 << 20
