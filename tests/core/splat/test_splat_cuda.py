"""The CUDA rasteriser without a graphics card: its kernels compiled for the CPU against the reference, and by NVRTC.

What these tests cannot show is the launch on a card; `test_on_a_graphics_card` does, where there is one.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest
import torch
from splat_scenes import OUTPUTS, SCENES, assert_parity, leaves_of, orbit, pulled, scene

from grmm_core.errors import BackendError
from grmm_core.splat import Gaussians, rasterize
from grmm_core.splat.autograd import rasterize_with
from grmm_core.splat.cuda import compile as cuda_compile
from grmm_core.splat.cuda.drawing import CudaEngine
from grmm_core.splat.cuda.launch import pack
from grmm_core.splat.cuda.source import FEATURES_MAX, KERNELS, THREADS, kernel_source
from grmm_core.splat.rules import View

COMPILER = shutil.which("g++") or shutil.which("clang++")
STAND_IN = Path(__file__).with_name("cuda_stand_in") / "stand_in.h"


class StandInKernels:
    """The same text, compiled by a C++ compiler and run on the CPU; see `stand_in.h`."""

    def __init__(self, features: int, folder: Path) -> None:
        cases = "".join(
            f'    if (!strcmp(name, "{kernel}")) return stand_in::launch({kernel}, x, y, {THREADS}, arguments), 0;\n'
            for kernel in KERNELS
        )
        text = (
            f'#include "{STAND_IN}"\n{kernel_source(features)}\n'
            f'extern "C" int run(const char *name, int x, int y, void **arguments) {{\n{cases}    return 1;\n}}\n'
        )
        source, library = folder / f"kernels_{features}.cpp", folder / f"kernels_{features}.so"
        source.write_text(text)
        command = [COMPILER, "-std=c++17", "-O2", "-w", "-shared", "-fPIC", "-o", library, source]
        subprocess.run(command, check=True, timeout=300)
        self.run = ctypes.CDLL(str(library)).run

    def launch(self, name, blocks, *arguments):
        for argument in arguments:
            if isinstance(argument, torch.Tensor):
                assert argument.is_contiguous()
        parameters, alive = pack(arguments)
        assert self.run(name.encode(), *blocks, parameters) == 0
        del alive


@pytest.fixture(scope="module")
def stand_in(tmp_path_factory):
    if COMPILER is None:
        pytest.skip("no C++ compiler")
    folder = tmp_path_factory.mktemp("kernels")
    made = {}

    def make(features):
        if features not in made:
            made[features] = StandInKernels(features, folder)
        return made[features]

    return make


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("name", SCENES)
def test_the_kernels_equal_the_reference(name, antialiased, stand_in):
    make, camera = SCENES[name]
    gaussians = make()
    kernels = stand_in(0 if gaussians.features is None else gaussians.features.shape[1])
    background = (0.2, 0.5, 0.7)
    leaves = leaves_of(gaussians, torch.float64)
    expected = pulled(rasterize(Gaussians(*leaves), camera, background, "torch", antialiased), leaves)
    leaves = leaves_of(gaussians, torch.float32)
    out = rasterize_with(CudaEngine(kernels), Gaussians(*leaves), View.of(camera), torch.tensor(background), antialiased)
    assert_parity(pulled(out, leaves), expected)


def test_equal_depths_and_dropped_gaussians(stand_in):
    many = scene(50, seed=3)
    many.means[:] = many.means[0] * 0.1
    for k, name in enumerate(("means", "quats", "scales", "opacities", "colors", "features")):
        getattr(many, name).view(50, -1)[10 + k, -1] = float("nan") if k % 2 else float("inf")
    many.quats[20] = 0.0
    ours = rasterize_with(CudaEngine(stand_in(4)), many, View.of(orbit()))
    expected = rasterize(many, orbit(), backend="torch")
    for name in OUTPUTS:
        torch.testing.assert_close(getattr(ours, name), getattr(expected, name), atol=1e-4, rtol=1e-4)


def test_nothing_to_draw_leaves_the_background(stand_in):
    ground = torch.rand(40, 48, 3, generator=torch.Generator().manual_seed(1)).requires_grad_()
    out = rasterize_with(CudaEngine(stand_in(4)), scene(0), View.of(orbit()), ground)
    torch.testing.assert_close(out.rgb, ground)
    out.rgb.sum().backward()
    torch.testing.assert_close(ground.grad, torch.ones_like(ground))
    assert out.alpha.abs().max() == 0


def test_background_pictures_and_their_gradients(stand_in):
    ground = torch.rand(40, 48, 3, generator=torch.Generator().manual_seed(1)).requires_grad_()
    out = rasterize_with(CudaEngine(stand_in(4)), scene(100, seed=2), View.of(orbit()), ground)
    expected = rasterize(scene(100, seed=2), orbit(), ground.detach(), "torch")
    torch.testing.assert_close(out.rgb, expected.rgb, atol=1e-5, rtol=1e-4)
    out.rgb.sum().backward()
    torch.testing.assert_close(ground.grad, (1 - expected.alpha)[..., None].expand(40, 48, 3), atol=1e-5, rtol=1e-4)


def test_gradients_are_the_same_every_time(stand_in):
    def gradients():
        leaves = leaves_of(scene(200, seed=5), torch.float32)
        return pulled(rasterize_with(CudaEngine(stand_in(4)), Gaussians(*leaves), View.of(orbit())), leaves)[1]

    for first, second in zip(gradients(), gradients(), strict=True):
        assert torch.equal(first, second)


@pytest.fixture(scope="module")
def compiler():
    try:
        return cuda_compile.load_compiler()
    except BackendError:
        pytest.skip("NVRTC is not installed")


@pytest.mark.parametrize(
    ("features", "architecture"), [(0, "sm_75"), (32, "sm_75"), (32, "sm_90"), (32, "compute_80"), (FEATURES_MAX, "sm_90")]
)
def test_nvrtc_compiles_the_kernels(features, architecture, compiler):
    image = cuda_compile.compile_source(kernel_source(features), architecture)
    for name in KERNELS:
        assert name.encode() in image


def test_the_papers_channels_stay_in_registers(compiler):
    """Arrays that the compiler cannot keep in registers would go through memory in the innermost loops."""
    text = cuda_compile.compile_source(kernel_source(32), "compute_90")
    assert b"__local_depot" not in text


def test_what_nvrtc_refuses_is_one_sentence(compiler):
    with pytest.raises(BackendError, match=r"could not be compiled for sm_90 .*error.*use the device cpu") as caught:
        cuda_compile.compile_source("this is no program", "sm_90")
    assert "\n" not in str(caught.value)


def test_a_missing_compiler_is_named(monkeypatch):
    monkeypatch.setattr(cuda_compile, "_candidates", lambda: iter(["no such library"]))
    with pytest.raises(BackendError, match="needs NVRTC"):
        cuda_compile.load_compiler()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("name", SCENES)
def test_on_a_graphics_card(name):
    from grmm_core.splat.cuda.launch import device_kernels

    make, camera = SCENES[name]
    gaussians = make()
    kernels = device_kernels(torch.device("cuda"), 0 if gaussians.features is None else gaussians.features.shape[1])
    leaves = leaves_of(gaussians, torch.float64)
    expected = pulled(rasterize(Gaussians(*leaves), camera, None, "torch"), leaves)
    leaves = leaves_of(gaussians, torch.float32)
    out = rasterize_with(CudaEngine(kernels), Gaussians(*leaves).to("cuda"), View.of(camera))
    out = type(out)(*(None if part is None else part.cpu() for part in (out.rgb, out.alpha, out.depth, out.features)))
    assert_parity(pulled(out, leaves), expected)
