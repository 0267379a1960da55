"""What is special about the compiled CPU rasteriser: threads, memory, caches, blocks of pixels, and that it needs no torch."""

from __future__ import annotations

import dataclasses
import threading

import numba
import numpy as np
import pytest
import torch
from splat_scenes import NAMES, OUTPUTS, leaves_of, orbit, pulled, scene
from tolerances import SPLAT_PICTURE
from without_torch import run_without_torch

from grmm_core.compute import threads
from grmm_core.errors import BackendError, ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.splat import GaussianArrays, Gaussians, rasterize, rasterize_arrays
from grmm_core.splat.cpu import jit


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
        leaves = leaves_of(scene(3000, seed=23), torch.float32)
        return pulled(rasterize(Gaussians(*leaves), orbit(100, 90), backend="cpu"), leaves)[1]

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
    with pytest.raises(BackendError, match="too large"):
        rasterize(scene(1), Camera(np.eye(4), 1.0, 1.0, 0.0, 0.0, 1 << 19, 1), backend="cpu")


def test_gaussians_that_would_fill_the_memory_are_refused(monkeypatch):
    """Each of them covers all tiles; a hostile file can hold millions."""
    from grmm_core.splat.cpu import drawing

    many = scene(50, seed=9, size=3.0)
    many.means.requires_grad_()
    monkeypatch.setattr(drawing, "MAX_GRADIENT_BYTES", 1000)
    out = rasterize(many, orbit(), backend="cpu")
    with pytest.raises(BackendError, match="too large and too many to differentiate"):
        out.rgb.sum().backward()
    monkeypatch.setattr(drawing, "MAX_INSTANCES", 100)
    with pytest.raises(BackendError, match="too large and too many to draw"):
        rasterize(many, orbit(), backend="cpu")


def test_blocks_are_found_exactly():
    """Against every pixel of the tile: no block that a Gaussian reaches is missed, and few others are listed."""
    from grmm_core.splat.cpu import blocks, tiling
    from grmm_core.splat.cpu.records import RECORD, SHAPE, SQUEEZE

    rng = np.random.default_rng(31)
    count, listed, reached = 400, 0, 0
    shapes = np.zeros((tiling.BATCH, SHAPE), np.float32)
    pairs = np.empty((tiling.BATCH + 1) * tiling.BLOCKS, np.int32)
    first = np.empty(tiling.BATCH + 1, np.int64)
    limits = np.full(tiling.BLOCKS, blocks.OPEN)
    for _ in range(count):
        x, y = rng.uniform(-30, 60, 2)
        l11, l22 = np.exp(rng.uniform(-4, 0.6, 2))  # from round to needles
        l12 = rng.normal() * l11
        shapes[0, : RECORD.opacity] = x, y, l11, l12, l22
        blocks.place_on(shapes, 0, np.float32(16), np.float32(0))
        shapes[0, RECORD.reach] = SQUEEZE**2 * rng.uniform(0.5, 11.0)
        found = blocks.find_blocks(1, shapes, limits, pairs, first)
        dx, dy = np.meshgrid(np.arange(16) + 16.5 - x, np.arange(16) + 0.5 - y)
        s, q = l11 * dx + l12 * dy, l22 * dy
        inside = SQUEEZE**2 * (s * s + q * q) <= shapes[0, RECORD.reach] * (1 - 1e-5)
        number = np.arange(16)[:, None] // tiling.BLOCK_Y * tiling.BLOCKS_X + np.arange(16) // tiling.BLOCK_X
        wanted = set(np.unique(number[inside]).tolist())
        assert wanted <= set(pairs[:found].tolist())
        assert len(set(pairs[:found].tolist())) == found
        listed, reached = listed + found, reached + len(wanted)
    assert reached > 500
    assert listed < 1.2 * reached


def test_work_is_counted():
    from grmm_core.splat.cpu import count, drawing
    from grmm_core.splat.rules import View

    many, camera = scene(200, seed=32), orbit()
    arrays = GaussianArrays(*(getattr(many, name).numpy() for name in NAMES))
    _, drawn = drawing.draw(arrays, np.zeros((1, 1, 3), np.float32), View.of(camera), False)
    work = count.count_work(drawn, camera.width, camera.height)
    # By the reference, with a feature of its own for each Gaussian: blended where that is above zero.
    marked = dataclasses.replace(many, features=torch.eye(200))
    expected = int((rasterize(marked, camera, backend="torch").features > 0).sum())
    assert work.needed == pytest.approx(expected, rel=1e-3)
    assert work.needed < work.blended <= work.evaluated < work.instances * 256


def test_memory_of_dropped_pictures_is_used_again_and_held_pictures_are_left_alone():

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
    kept = kept_bytes()
    assert kept >= second.features.numel() * 4
    third = rasterize(scene(0, channels=8), camera, background=(0.1, 0.2, 0.3))
    assert third.features.data_ptr() == place
    assert kept_bytes() < kept
    for tensor in (third.alpha, third.depth, third.features):  # what was drawn there before is gone
        assert tensor.abs().max() == 0
    torch.testing.assert_close(third.rgb, torch.tensor([0.1, 0.2, 0.3]).expand(260, 300, 3))


def kept_bytes():
    from grmm_core.compute import buffers

    return sum(one.nbytes for one in buffers._free)


def test_kept_memory_is_bounded(monkeypatch):
    from grmm_core.compute import buffers

    monkeypatch.setattr(buffers, "KEPT_BYTES", 3 << 20)
    held = [buffers.empty((1 << 18,)) for _ in range(6)]
    del held
    assert kept_bytes() <= 3 << 20


def test_arrays_are_drawn_where_torch_is_missing(tmp_path):
    """In a process where importing torch fails; the same picture as the reference's, plain and antialiased, also on a crop."""
    many, camera = scene(300, seed=35), orbit(64, 48)
    np.savez(tmp_path / "scene.npz", **{name: getattr(many, name).numpy() for name in NAMES})
    script = """
        import numpy as np
        from grmm_core.geometry.camera import Camera
        from grmm_core.splat import GaussianArrays, rasterize_arrays
        scene = GaussianArrays(**np.load("scene.npz"))
        camera = Camera.orbit(64, 48, yaw=20.0, pitch=10.0, distance=0.6, fov=25.0)
        whole = rasterize_arrays(scene, camera, (0.2, 0.5, 0.7))
        part = rasterize_arrays(scene, camera.crop(19, 7, 30, 35), antialiased=True, frame=camera)
        np.savez("pictures.npz", **whole._asdict(), **{f"part_{name}": array for name, array in part._asdict().items()})
    """
    run_without_torch(script, tmp_path)
    expected = rasterize(many, camera, (0.2, 0.5, 0.7), backend="torch")
    expected_part = rasterize(many, camera.crop(19, 7, 30, 35), backend="torch", antialiased=True, frame=camera)
    with np.load(tmp_path / "pictures.npz") as pictures:
        for name in OUTPUTS:
            for ours, theirs in ((pictures[name], expected), (pictures[f"part_{name}"], expected_part)):
                wanted = getattr(theirs, name).numpy()
                assert np.abs(ours - wanted).max() < SPLAT_PICTURE * max(1.0, np.abs(wanted).max())


def test_arrays_that_do_not_fit_are_refused():
    arrays = GaussianArrays(*(getattr(scene(5), name).numpy() for name in NAMES))
    with pytest.raises(ShapeError, match=r"quats has the shape \[4, 4\]; \[5, 4\] is needed"):
        rasterize_arrays(arrays._replace(quats=arrays.quats[:4]), orbit())
    with pytest.raises(ShapeError, match="background"):
        rasterize_arrays(arrays, orbit(), np.zeros((2, 2, 3)))


def test_arrays_may_be_views_of_another_type_that_cannot_be_written():
    many = scene(50, seed=36)
    arrays = GaussianArrays(*(getattr(many, name).double().numpy()[::-1] for name in NAMES))
    for array in arrays:
        array.setflags(write=False)
    flipped = Gaussians(*(getattr(many, name).flip(0) for name in NAMES))
    np.testing.assert_array_equal(rasterize_arrays(arrays, orbit()).rgb, rasterize(flipped, orbit(), backend="cpu").rgb.numpy())


@pytest.mark.parametrize(("plain", "halved"), [(0, 1), (1, 14), (3, 4), (2, 21)])
def test_features_of_half_the_size_are_means(plain, halved):
    """Sums for squares of pixels give what summing for pixels and taking means gives, also at odd edges."""
    rng = np.random.default_rng(5)
    count, width, height = 600, 75, 53
    features = rng.normal(size=(count, plain + halved)).astype(np.float32)
    features[: count // 2] = 0.0  # need few channels, as strands do
    features[: count // 4, : plain + 1] = 1.0
    scene = GaussianArrays(
        rng.uniform(-0.1, 0.1, (count, 3)), rng.normal(size=(count, 4)), rng.uniform(0.001, 0.02, (count, 3)),
        rng.uniform(0.05, 0.9, count), rng.random((count, 3)), features,
    ).prepared()  # fmt: skip
    camera = Camera.orbit(width, height)
    whole, half = rasterize_arrays(scene, camera), rasterize_arrays(scene, camera, halved=halved)
    for name in ("rgb", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(half, name), getattr(whole, name))
    np.testing.assert_allclose(half.features, whole.features[..., :plain], atol=1e-6)
    assert half.halves.shape == (27, 38, halved)
    for y, x in np.ndindex(27, 38):
        wanted = whole.features[2 * y : 2 * y + 2, 2 * x : 2 * x + 2, plain:].mean((0, 1))
        np.testing.assert_allclose(half.halves[y, x], wanted, atol=1e-5)
