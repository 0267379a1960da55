"""Scenes of Gaussians on which every backend of the rasteriser is held to the readable reference."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from tolerances import SPLAT_GRADIENT, SPLAT_PICTURE

from grmm_core.geometry.camera import Camera
from grmm_core.splat import Gaussians

NAMES = ("means", "quats", "scales", "opacities", "colors", "features")
OUTPUTS = ("rgb", "alpha", "depth", "features")


def scene(count, channels=4, seed=0, dtype=torch.float32, spread=0.12, size=0.012):
    random = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=random, dtype=torch.float64).to(dtype)

    def uniform(*shape):
        return torch.rand(*shape, generator=random, dtype=torch.float64).to(dtype)

    features = normal(count, channels) if channels else None
    return Gaussians(
        spread * normal(count, 3),
        normal(count, 4),
        size * torch.exp(0.5 * normal(count, 3)),
        uniform(count),
        uniform(count, 3),
        features,
    )


def orbit(width=48, height=40, **options):
    return Camera.orbit(width, height, **{"yaw": 20.0, "pitch": 10.0, "distance": 0.6, "fov": 25.0, **options})


def changed(gaussians, **changes):
    return dataclasses.replace(gaussians, **changes)


def behind():
    many = scene(60, seed=5)
    many.means[::3] -= torch.tensor(orbit().forward, dtype=torch.float32) * 2.0
    return many


def needles():
    many = scene(80, seed=6)
    many.scales[:, 0], many.scales[:, 1:] = 0.3, 1e-6
    return many


def coincident():
    many = scene(60, seed=7)
    many.means[:] = many.means[0] * 0.1
    return changed(many, opacities=many.opacities * 0.2)


def nearly_opaque():
    many = scene(300, seed=8, size=0.03)
    return changed(many, opacities=0.9 + 0.1 * many.opacities)


SCENES = {
    "ordinary": (lambda: scene(300, seed=1), orbit()),
    "many in a tile": (lambda: scene(2000, seed=2, spread=0.03, size=0.004), orbit(20, 20)),
    "no features": (lambda: scene(100, channels=0, seed=3), orbit()),
    "one feature": (lambda: scene(100, channels=1, seed=3), orbit()),
    "32 features": (lambda: scene(150, channels=32, seed=4), orbit(33, 31)),
    "33 features": (lambda: scene(50, channels=33, seed=4), orbit(17, 16)),
    "some behind the camera": (behind, orbit()),
    "huge": (lambda: scene(20, seed=9, size=3.0), orbit()),
    "needle-thin": (needles, orbit(80, 80)),
    "transparent": (lambda: changed(scene(80, seed=10), opacities=torch.linspace(0, 0.02, 80)), orbit()),
    "nearly opaque": (nearly_opaque, orbit()),
    "opacities above one": (lambda: changed(scene(80, seed=20, size=0.01), opacities=torch.linspace(0.5, 1.5, 80)), orbit()),
    "coincident depths": (coincident, orbit()),
    "off-screen": (lambda: scene(200, seed=12, spread=0.6, size=0.1), orbit(32, 24)),
    "one pixel": (lambda: scene(100, seed=13), orbit(1, 1, fov=1.0)),
    "one Gaussian": (lambda: scene(1, seed=14, size=0.1), orbit()),
    "points": (lambda: changed(scene(100, seed=15), scales=torch.zeros(100, 3)), orbit()),
    "orthographic": (lambda: scene(200, seed=16), dataclasses.replace(orbit(), orthographic=True, fx=200.0, fy=180.0)),
    "crop": (lambda: scene(200, seed=17), orbit(64, 48).crop(19, 7, 30, 35)),
    "shifted, mirrored": (lambda: scene(200, seed=18), dataclasses.replace(orbit(), fx=-90.0, fy=70.0, cx=-5.0, cy=60.0)),
    "scaled world": (lambda: scene(200, seed=19), orbit().transformed(np.diag([2.0, 2.0, 2.0, 1.0]))),
}


def leaves_of(gaussians, dtype):
    """Copies of the fields, in the order of NAMES, that collect gradients."""
    fields = [getattr(gaussians, name) for name in NAMES]
    return [None if field is None else field.to(dtype).clone().requires_grad_() for field in fields]


def pulled(out, leaves):
    """The pictures of a rendering, and the gradients of the leaves under a fixed random pull on every value of them."""
    pictures = [getattr(out, name) for name in OUTPUTS if getattr(out, name) is not None]
    random = torch.Generator().manual_seed(99)
    pulls = [torch.randn(p.shape, generator=random, dtype=torch.float64).to(p.dtype) for p in pictures]
    gradients = torch.autograd.grad(pictures, [leaf for leaf in leaves if leaf is not None], pulls)
    return [p.detach().double() for p in pictures], [g.double() for g in gradients]


def assert_parity(ours, theirs):
    """Compare what `pulled` returned for a backend with what it returned for the reference."""
    for names, floor, tolerance, found, expected in zip(
        (OUTPUTS, NAMES), (1.0, 1e-3), (SPLAT_PICTURE, SPLAT_GRADIENT), ours, theirs, strict=True
    ):
        for name, one, other in zip(names, found, expected, strict=False):
            assert one.isfinite().all()
            error = (one - other).abs().max() / other.abs().max().clamp(min=floor)
            assert error < tolerance, f"{name}: {error:.2e}"
