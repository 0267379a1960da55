from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import correlate1d

from grmm_core.errors import ConfigError, ShapeError
from grmm_core.training.blur import blur
from grmm_core.training.losses import (
    LossWeights,
    code_loss,
    depth_loss,
    psnr,
    scale_loss,
    ssim,
    vertex_laplacian,
    weights_from,
)

ROOT = Path(__file__).parents[3]


def naive_ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Wang et al. 2004 with an 11-pixel Gaussian window, cut and renormalised at the border."""
    window = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    one = np.ones(a.shape[:2])

    def blur(image):
        for axis in (0, 1):
            image = correlate1d(image, window, axis=axis, mode="constant")
        return image

    weight = blur(one)
    values = []
    for channel in range(a.shape[2]):
        x, y = a[..., channel], b[..., channel]
        mx, my = blur(x) / weight, blur(y) / weight
        vx, vy = blur(x * x) / weight - mx**2, blur(y * y) / weight - my**2
        vxy = blur(x * y) / weight - mx * my
        c1, c2 = 0.01**2, 0.03**2
        values.append(((2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean())
    return float(np.mean(values))


@pytest.mark.parametrize("size", [(40, 31), (7, 9)])
def test_ssim_against_a_plain_one(size):
    rng = np.random.default_rng(0)
    a = rng.random((*size, 3))
    b = np.clip(a + rng.normal(0, 0.2, a.shape), 0, 1)
    got = float(ssim(torch.from_numpy(a), torch.from_numpy(b)))
    assert got == pytest.approx(naive_ssim(a, b), abs=1e-9)
    assert 0.1 < got < 0.95
    assert float(ssim(torch.from_numpy(a), torch.from_numpy(a))) == pytest.approx(1.0)


def test_ssim_gradient():
    a, b = torch.rand(9, 8, 2, dtype=torch.float64, requires_grad=True), torch.rand(9, 8, 2, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: ssim(x, b), (a,))


def test_fast_window_is_the_banded_products_and_their_gradient():
    generator = torch.Generator().manual_seed(1)
    for size in ((40, 31), (7, 9), (4, 3)):
        planes, weight = (torch.randn(3, *size, generator=generator) for _ in range(2))
        results = []
        for dtype in (torch.float32, torch.float64):  # float64 takes the products
            x = planes.detach().to(dtype, copy=True).requires_grad_(True)
            y = blur(x)
            (y * weight).sum().backward()
            results.append((y.detach().double(), x.grad.double()))
        for fast, plain in zip(*results, strict=True):
            torch.testing.assert_close(fast, plain, atol=1e-5, rtol=0)


def test_torch_keeps_its_threads():
    """Numba's own pool once set OpenMP's: torch, told to use one thread, went on with all, which wait by spinning."""
    code = "import torch\nfrom grmm_core.training.blur import blur\nblur(torch.rand(3, 90, 80))\nprint(torch.get_num_threads())"
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout == "1\n"


def test_ssim_refuses_other_shapes():
    with pytest.raises(ShapeError):
        ssim(torch.zeros(4, 4, 3), torch.zeros(5, 4, 3))


def test_scale_loss_values():
    """Eq. 18 by hand, in millimetres."""
    scales = torch.tensor([[0.05, 1.0, 12.0], [0.1, 10.0, 0.0]], dtype=torch.float64)
    assert float(scale_loss(scales)) == pytest.approx((1 / 0.05 + 0 + 4.0 + 0 + 0 + 1e7) / 6)


def test_scale_loss_pushes_back_into_the_range():
    scales = torch.tensor([0.05, 5.0, 12.0], requires_grad=True)
    scale_loss(scales).backward()
    assert scales.grad[0] < 0  # grows
    assert scales.grad[1] == 0
    assert scales.grad[2] > 0  # shrinks


def test_code_loss_is_the_squared_length():
    assert float(code_loss(torch.tensor([3.0, 4.0]), torch.tensor([[1.0, 0.0], [0.0, 3.0]]))) == pytest.approx(25 + 5)


def test_laplacian_of_a_plane_and_of_a_spike():
    # a fan: vertex 0 in the middle of a hexagon
    faces = torch.tensor([[0, i, i % 6 + 1] for i in range(1, 7)])
    angle = torch.arange(6) * torch.pi / 3
    ring = torch.stack([angle.cos(), angle.sin(), torch.zeros(6)], -1)
    vertices = torch.cat([torch.zeros(1, 3), ring])
    laplacian = vertex_laplacian(faces, 8)  # vertex 7 is loose
    result = laplacian(torch.cat([vertices, torch.ones(1, 3)]))
    torch.testing.assert_close(result[0], torch.zeros(3), atol=1e-6, rtol=0)
    torch.testing.assert_close(result[7], torch.zeros(3))
    vertices[0, 2] = 2.0
    result = laplacian(torch.cat([vertices, torch.ones(1, 3)]))
    torch.testing.assert_close(result[0], torch.tensor([0.0, 0.0, 2.0]), atol=1e-6, rtol=0)


def test_depth_loss_counts_known_and_covered_pixels():
    depth = torch.tensor([[1.0, 1.1, 1.2, 5.0]], requires_grad=True)
    alpha = torch.tensor([[1.0, 1.0, 0.2, 1.0]])
    target = torch.tensor([[1.0, 1.0, 1.0, 0.0]])
    # 1 dm of error in one of two pixels
    assert float(depth_loss(depth, alpha, target).detach()) == pytest.approx(0.5, rel=1e-4)
    empty = depth_loss(depth, alpha, torch.zeros(1, 4))
    empty.backward()
    assert float(empty.detach()) == 0.0


def test_psnr_by_hand_and_inside_a_mask():
    a, b = torch.zeros(2, 2, 3), torch.full((2, 2, 3), 0.1)
    assert psnr(a, b) == pytest.approx(20.0, abs=1e-4)
    b[0] = 0.0
    assert psnr(a, b, torch.tensor([[0, 0], [1, 1]])) == pytest.approx(20.0, abs=1e-4)
    assert psnr(a, a) == float("inf")


def test_the_papers_weights_are_the_defaults():
    w = LossWeights()
    assert (w.l1, w.ssim, w.perceptual, w.code, w.laplacian, w.scale, w.depth) == (0.8, 0.2, 0.04, 0.001, 0.01, 0.1, 0.5)


@pytest.mark.parametrize("values", [{"smell": 1.0}, {"l1": -1.0}, {"l1": float("nan")}, {"l1": "much"}])
def test_bad_weights_are_named(values):
    with pytest.raises(ConfigError, match=next(iter(values))):
        weights_from(values)
