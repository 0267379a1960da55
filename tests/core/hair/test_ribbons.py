"""Strands as Gaussians: the compiled kernels against the readable text and finite differences, cover, light, levels."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.gradients import strand_segments
from grmm_core.hair.occlusion import openness
from grmm_core.hair.ribbons import OPACITY, Eye, segments, shade
from grmm_core.hair.strands import blocks_of, lengthened
from grmm_core.head import load_open_head
from grmm_core.pictures.color import linear_to_srgb
from grmm_core.splat import Gaussians, rasterize

EYES = {
    "perspective": Eye.of(Camera.orbit(200, 160, 25, 10, 0.8)),
    "parallel": Eye(np.eye(3, dtype=np.float32), np.array([0, 0, 1], np.float32), 700.0, orthographic=True),
    "none": None,
}


def strands(count: int = 40, points: int = 7, seed: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    g = np.random.default_rng(seed)
    path = g.normal(0, 0.05, (count, 1, 3)) + np.cumsum(g.normal(0, 0.006, (count, points, 3)), 1)
    return path, np.abs(g.normal(2e-4, 1e-4, (count, 2))) + 2e-5, g.uniform(0.2, 1.0, count)


@pytest.mark.parametrize("eye", EYES)
def test_the_kernel_is_the_readable_text(eye):
    inputs = [torch.tensor(part, dtype=torch.float32) for part in strands()]
    for ours, theirs in zip(strand_segments(*inputs, EYES[eye]), segments(*inputs, EYES[eye]), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize("eye", EYES)
def test_numpy_and_torch_are_one_text(eye):
    arrays = [part.astype(np.float64) for part in strands()]
    for ours, theirs in zip(segments(*arrays, EYES[eye]), segments(*map(torch.tensor, arrays), EYES[eye]), strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("eye", EYES)
def test_gradients_are_those_of_the_readable_text(eye):
    g = torch.Generator().manual_seed(3)
    given = [torch.randn(shape, generator=g) for shape in ((40, 6, 3), (40, 6, 4), (40, 6, 3), (40, 6))]
    found = []
    for function, dtype in ((strand_segments, torch.float32), (segments, torch.float64)):
        inputs = [torch.tensor(part, dtype=dtype, requires_grad=True) for part in strands()]
        sum((a * b).sum() for a, b in zip(function(*inputs, EYES[eye]), given, strict=True)).backward()
        found.append([part.grad.double() for part in inputs])
    for ours, theirs in zip(*found, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=2e-3, atol=2e-3 * float(theirs.abs().max()))


def test_the_readable_text_has_the_gradients_of_finite_differences():
    inputs = [torch.tensor(part, dtype=torch.float64, requires_grad=True) for part in strands(4, 4)]
    assert torch.autograd.gradcheck(
        lambda *parts: segments(*parts, EYES["perspective"]), inputs, eps=1e-7, atol=1e-3, rtol=1e-3
    )


def test_colors_of_points_get_gradients_through_a_picture():
    points, radii, opacity = (torch.tensor(part, dtype=torch.float32) for part in strands(30))
    colors = torch.full((30, 7, 3), 0.5, requires_grad=True)
    made = strand_segments(points.requires_grad_(), radii.requires_grad_(), opacity.requires_grad_(), EYES["perspective"])
    parts = (made.means, made.quats, made.scales, made.opacities, 0.5 * (colors[:, 1:] + colors[:, :-1]))
    picture = rasterize(Gaussians(*(part.flatten(0, 1) for part in parts)), Camera.orbit(200, 160, 25, 10, 0.8))
    picture.rgb.sum().backward()
    for leaf in (points, radii, opacity, colors):
        assert torch.isfinite(leaf.grad).all()
        assert float(leaf.grad.abs().sum()) > 0


def cover_of(width: float, camera: Camera, opacity: float = OPACITY) -> float:
    """Pixels that a strand of 10 cm covers beside the middle of a picture."""
    path = np.linspace([-0.05, 0.003, 0.0], [0.05, -0.003, 0.0], 9)[None]
    made = segments(path, np.full((1, 2), 0.5 * width), np.full(1, opacity), Eye.of(camera))
    flat = [torch.tensor(part.reshape(-1, *part.shape[2:]), dtype=torch.float32) for part in made]
    return float(rasterize(Gaussians(*flat, torch.ones(8, 3)), camera).alpha.sum())


def test_a_strand_thinner_than_a_pixel_covers_what_a_ribbon_of_its_width_does():
    """However much the rasteriser widens it, and however much of a faint one it leaves out."""
    camera = Camera.orbit(256, 256, distance=1.0, fov=20.0)  # whose pixels are 1.4 mm
    widths = np.array([2e-5, 5e-5, 1e-4, 2e-4, 4e-4])
    covers = [cover_of(width, camera) for width in widths]
    np.testing.assert_allclose(covers, 0.1002 * scale_of(camera) * widths * scale_of(camera), rtol=0.06)
    assert cover_of(1e-4, camera, 0.0) == 0.0


def scale_of(camera: Camera) -> float:
    return Eye.of(camera).pixels_per_metre()


@pytest.mark.parametrize(("eye", "sheen"), [("perspective", 1.0), ("parallel", 2.5)])
def test_compiled_shading_is_the_readable_text(eye, sheen):
    from grmm_core.hair.strand_kernels import shade_into

    g = np.random.default_rng(7)
    points = strands(20, 5)[0].astype(np.float32)
    albedo = np.repeat(g.uniform(0.01, 0.5, (20, 1, 3)), 2, 1).astype(np.float32)
    light = np.concatenate([g.uniform(0.05, 0.9, (20, 1, 1)), g.normal(0, 0.3, (20, 1, 3))], 2).repeat(5, 1).astype(np.float32)
    colors, share = np.empty((80, 3), np.float32), g.uniform(0.1, 2.0, (20, 4)).astype(np.float32)
    shade_into(points, albedo, light, share, np.ones(80, np.float32), EYES[eye].numbers(), sheen, colors)
    step = np.diff(points, axis=1)
    axes = step / np.linalg.norm(step, axis=2, keepdims=True)
    means = 0.5 * (points[:, 1:] + points[:, :-1])
    shown = shade(means, axes, np.repeat(albedo[:, :1], 4, 1), light[:, 1:], share, EYES[eye], sheen)
    np.testing.assert_allclose(colors.reshape(20, 4, 3), linear_to_srgb(np.clip(shown, 0, 1)), atol=2e-3)


@pytest.mark.parametrize(
    ("values", "left"), [({"density": 0.2}, 0.4), ({"length": 0.3}, 0.8), ({"length": 0.15, "density": 0.5}, 0.5)]
)
def test_fewer_and_shorter_hairs_let_in_about_the_light_that_is_traced_anew(values, left):
    head, settings = load_open_head(), HairSettings(**values)
    template = np.asarray(head.v_template, float)
    (block,) = blocks_of(library_groom("long").level(0.1), template, head.faces)
    origin, axes = block.frames.at(template)
    points = np.matmul(lengthened(block.points, settings.length), axes) + origin[:, None]
    widths = settings.density * block.widths.mean(1) * len(block) / len(block.points)
    traced = openness(points, widths, template, head.faces)[..., 0]
    before, after = (np.abs(light[..., 0] - traced).mean() for light in (block.light, block.lit(settings)))
    assert after < left * before
    np.testing.assert_array_equal(block.lit(HairSettings(thickness=2.0)), block.light)
