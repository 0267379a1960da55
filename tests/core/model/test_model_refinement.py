"""The refinement network (eq. 14) at full and at half resolution."""

from __future__ import annotations

import pytest
import torch
from model_fixtures import randomise

from grmm_core.model.config import PRESETS
from grmm_core.model.refine import RefinementNetwork
from grmm_core.model.steps import depth_range, normalise_depth
from grmm_core.splat import RasterOutput


@pytest.mark.parametrize("size", [(16, 16), (17, 23), (3, 5)])
def test_untrained_refinement_changes_nothing(size):
    network = RefinementNetwork(PRESETS["tiny"])
    rgb, features, depth, alpha = torch.rand(*size, 3), torch.rand(*size, 4), torch.rand(*size), torch.rand(*size)
    torch.testing.assert_close(network(rgb, features, depth, alpha), rgb)


def test_refinement_leaves_empty_pixels_alone():
    network = RefinementNetwork(PRESETS["tiny"])
    torch.nn.init.normal_(network.exit.weight)
    alpha = torch.zeros(16, 16)
    alpha[4:12, 4:12] = 1.0
    rgb = torch.rand(16, 16, 3) * alpha[..., None]
    refined = network(rgb, torch.rand(16, 16, 4), torch.rand(16, 16), alpha)
    assert (refined[alpha == 0] == 0).all()
    assert (refined[alpha == 1] != rgb[alpha == 1]).any()


def test_depth_is_normalised_over_covered_pixels():
    depth = torch.tensor([[0.0, 1.0, 1.5, 2.0, 9.0]])
    alpha = torch.tensor([[0.0, 1.0, 1.0, 1.0, 0.2]])
    limits = depth_range(depth, alpha)
    assert limits.tolist() == [1.0, 2.0]
    assert normalise_depth(depth, alpha, limits).tolist() == [[0.0, 0.0, 0.5, 1.0, pytest.approx(0.2)]]
    assert depth_range(depth, alpha * 0).tolist() == [0.0, 0.0]


def covered_raster(height, width, features):
    generator = torch.Generator().manual_seed(11)
    alpha = torch.zeros(height, width)
    alpha[3 : height - 4, 5 : width - 3] = 0.7
    values = torch.rand(height, width, 3 + features, generator=generator) * alpha[..., None]
    depth = torch.where(alpha > 0, 1.0 + 0.1 * torch.rand(height, width, generator=generator), 0.0)
    return RasterOutput(values[..., :3], alpha, depth, values[..., 3:])


@pytest.mark.parametrize(("height", "width"), [(24, 20), (23, 21)])
def test_coarse_refinement_enlarges_the_residual(model, height, width):
    """A network that adds the same everywhere must add it at either resolution, up to and not beyond the silhouette."""
    with torch.no_grad():
        model.refinement.exit.bias.fill_(0.1)
    raster = covered_raster(height, width, model.config.features)
    fine, coarse = model.refine(raster), model.refine(raster, coarse=True)
    torch.testing.assert_close(fine, raster.rgb + 0.1 * raster.alpha[..., None])
    torch.testing.assert_close(coarse, fine, atol=1e-5, rtol=0)


def test_coarse_refinement_looks_at_a_quarter_of_the_pixels(model):
    randomise(model)
    seen = []
    model.refinement.entry.register_forward_hook(lambda module, inputs, output: seen.append(len(inputs[0])))
    raster = covered_raster(64, 48, model.config.features)
    fine, coarse = model.refine(raster), model.refine(raster, coarse=True)
    assert seen[1] * 4 == seen[0]
    assert (coarse - raster.rgb).abs().max() > 1e-3
    assert (coarse - fine)[raster.alpha == 0].abs().max() == 0


def test_refinement_in_half_precision_is_close(model):
    randomise(model)
    raster = covered_raster(64, 48, model.config.features)
    exact = model.refine(raster)
    model.half_refinement = True
    rounded = model.refine(raster)
    assert rounded.dtype == torch.float32
    change = (exact - raster.rgb).abs().max()
    assert 0 < (rounded - exact).abs().max() < 0.05 * change
