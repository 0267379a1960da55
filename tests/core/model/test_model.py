"""The model of the paper's section 3.3: sizes, decoders, codes, and the whole chain with its gradients."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from model_fixtures import SHAPES, TEETH, inputs, randomise, small_head

from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.errors import ConfigError, ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.tensor_rotations import euler_to_rotvec
from grmm_core.model.config import BASIS_COLOR, PRESETS, GRMMConfig
from grmm_core.model.decoders import MapDecoder
from grmm_core.model.grmm import GRMM
from grmm_core.model.inputs import ModelInputs

# --- configuration ---------------------------------------------------------------------------------------------------


def test_presets_survive_json():
    for config in PRESETS.values():
        assert GRMMConfig.from_json(config.to_json()) == config


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"grid": 100}, "decoder_grid"),
        ({"z_id": -1}, "z_id"),
        ({"z_id": 1.5}, "z_id"),
        ({"refine_unshuffle": 3}, "refine_unshuffle"),
        ({"decoder_channels": (8, 10**9)}, "decoder_channels"),
        ({"view_stage": 5}, "view_stage"),
        ({"basis_channels": ("smell",)}, "smell"),
        ({"position_unit_mm": math.nan}, "position_unit_mm"),
        ({"color": 1}, "color"),
    ],
)
def test_inconsistent_configurations_are_named(change, word):
    with pytest.raises(ConfigError, match=word):
        PRESETS["tiny"].replace(**change)


def test_paper_sizes(head):
    config = PRESETS["paper"]
    assert (config.z_id, config.z_exp, config.alpha_exp, config.grid, config.features) == (512, 256, 100, 512, 32)
    with torch.device("meta"):
        model = GRMM(head, config)
        z_id, z_exp, view = torch.zeros(1, 512), torch.zeros(1, 256), torch.zeros(1, 3)
        decoders = model.decoders
        assert decoders.transform(torch.cat([z_id, z_exp], 1)).shape == (1, 10, 512, 512)
        assert decoders.opacity(z_id).shape == (1, 1, 512, 512)
        assert decoders.appearance(z_id, view).shape == (1, 35, 512, 512)
    assert model.refinement.entry.in_features == 36
    assert not any("mean" in name or "basis" in name for name, _ in model.named_parameters())
    # 3 view channels join at the 8 x 8 start map
    assert decoders.appearance.stages[0].in_channels == config.decoder_channels[0] + 3


# --- mesh decoder ----------------------------------------------------------------------------------------------------


def test_film_formula(model):
    """Eq. 7-9 with numpy."""
    decoder = model.mesh_decoder.double()
    generator = torch.Generator().manual_seed(5)
    base, z_exp, alpha = (torch.randn(2, n, generator=generator, dtype=torch.float64) for n in (12, 5, 52))
    first, last = decoder.film[0], decoder.film[2]
    padded = np.zeros((2, 100))
    padded[:, :52] = alpha.numpy()
    hidden = padded @ first.weight.detach().numpy().T + first.bias.detach().numpy()
    hidden = np.where(hidden > 0, hidden, 0.2 * hidden)
    gamma, beta = np.split(hidden @ last.weight.detach().numpy().T + last.bias.detach().numpy(), 2, axis=1)
    features = np.concatenate([base.numpy(), z_exp.numpy()], 1)
    expected = features + gamma * features + beta
    np.testing.assert_allclose(decoder.modulate(base, z_exp, alpha).detach().numpy(), expected, atol=1e-12)


def test_displacement_starts_at_zero(model):
    result = model.displacement(inputs(model))
    assert result.shape == (model.head_model.vertex_count, 3)
    assert not result.any()


def test_expression_does_not_move_teeth_but_identity_does(model):
    randomise(model)
    data = inputs(model)

    def displacement(**changes):
        return model.displacement(dataclasses.replace(data, **changes)).detach().numpy()

    one = displacement()
    other = displacement(z_exp=-data.z_exp, expression=-data.expression)
    moved = np.abs(one - other).max(1)
    assert (moved[TEETH] == 0).all()
    assert (np.delete(moved, TEETH) > 0).all()
    person = displacement(z_id=-data.z_id)
    assert (np.abs(one - person).max(1)[TEETH] > 0).all()


def test_displacement_is_in_millimetres(model):
    with torch.no_grad():
        model.mesh_decoder.identity[-1].bias.fill_(1.0)
    result = model.displacement(ModelInputs(*(torch.zeros(n) for n in (6, 5, SHAPES, 52)), torch.zeros(5, 3)))
    torch.testing.assert_close(result, torch.full_like(result, 1e-3))


def test_rotation_vectors():
    generator = torch.Generator().manual_seed(6)
    euler = torch.randn(200, 3, generator=generator, dtype=torch.float64) * 1.5
    vectors = euler_to_rotvec(euler)
    skew = torch.zeros(200, 3, 3, dtype=torch.float64)
    x, y, z = vectors.unbind(-1)
    skew[:, 2, 1], skew[:, 1, 2], skew[:, 0, 2], skew[:, 2, 0], skew[:, 1, 0], skew[:, 0, 1] = x, -x, y, -y, z, -z
    from grmm_core.geometry.rotations import euler_to_matrix

    torch.testing.assert_close(torch.linalg.matrix_exp(skew), euler_to_matrix(euler), atol=1e-10, rtol=0)
    assert vectors.norm(dim=-1).max() <= math.pi + 1e-9
    rest = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(euler_to_rotvec, rest)
    torch.testing.assert_close(jacobian, torch.eye(3, dtype=torch.float64))


# --- decoders and codes ----------------------------------------------------------------------------------------------


def test_opacity_depends_on_identity_only_and_appearance_on_the_view(model):
    randomise(model)
    data = inputs(model)
    front, side = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
    vertices = torch.from_numpy(model.head_model.v_template.copy())
    one = model.gaussians(vertices, model.attributes(data, front))
    other = model.gaussians(vertices, model.attributes(dataclasses.replace(data, z_exp=-data.z_exp), side))
    torch.testing.assert_close(one.opacities, other.opacities)
    assert ((one.opacities > 0) & (one.opacities < 1)).all()
    assert (one.colors - other.colors).abs().max() > 1e-4
    assert (one.features - other.features).abs().max() > 1e-4
    assert (one.means - other.means).abs().max() > 1e-5
    added = model.expression_colors(data.z_id, data.z_exp)
    torch.testing.assert_close(model.appearance(data.z_id, front)[0] + added, one.colors)


def test_expression_maps_color_by_expression_with_a_gain_by_identity(model):
    randomise(model)
    maps = model.decoders.expression
    z_id, z_exp = inputs(model).z_id, inputs(model).z_exp
    weights = (maps.weights.weight @ z_exp) * (1 + maps.gains.weight @ z_id)
    expected = torch.einsum("k,knc->nc", weights, maps.maps.view(len(weights), -1, 3))
    torch.testing.assert_close(model.expression_colors(z_id, z_exp), expected)
    assert expected.abs().max() > 1e-3
    assert not model.expression_colors(z_id, 0 * z_exp).any()
    assert not torch.equal(model.expression_colors(-z_id, z_exp), expected)


def test_without_expression_maps_nothing_is_added():
    plain = GRMM(small_head(), PRESETS["tiny"].replace(expression_maps=0))
    assert plain.decoders.expression is None
    added = plain.expression_colors(torch.ones(plain.z_id_size), torch.ones(plain.z_exp_size))
    assert added.shape == (1, 3)
    assert not added.any()


def test_view_direction_enters_at_its_stage():
    decoder = MapDecoder(3, 2, 4, (8, 8, 8), view_stage=8)
    assert [stage.in_channels for stage in decoder.stages] == [8, 11, 8]
    assert decoder(torch.zeros(1, 3), torch.zeros(1, 3)).shape == (1, 2, 32, 32)


def test_basis_maps_are_linear_in_the_identity_code(model):
    decoders = model.decoders
    for name, width in (("position", 3), (BASIS_COLOR, 3), ("opacity", 1)):
        one, two = torch.randn(6), torch.randn(6)
        both = decoders._basis(name, one + two, width)
        separate = decoders._basis(name, one, width) + decoders._basis(name, two, width)
        torch.testing.assert_close(both, separate, atol=1e-5, rtol=0)
        assert both.shape == (model.gaussian_count, width)


def test_expression_codes_are_a_weighted_sum(model):
    aligned = torch.zeros(len(ALIGNED_NAMES))
    aligned[24], aligned[43] = 0.5, 0.25
    offset = torch.ones(5)
    expected = 0.5 * model.aligned_codes[24] + 0.25 * model.aligned_codes[43] + 1.0
    torch.testing.assert_close(model.z_expression(aligned, offset), expected)


def test_without_residuals_coefficients_take_the_codes_places(head):
    model = GRMM(head, PRESETS["tiny"].replace(residuals=False))
    assert (model.z_id_size, model.z_exp_size) == (SHAPES, 52)
    assert model.aligned_codes is None
    data = inputs(model)
    assert model.z_identity(torch.zeros(6), data.shape) is data.shape
    torch.testing.assert_close(model.z_expression(torch.zeros(60), expression=data.expression), data.expression)
    with pytest.raises(ConfigError):
        model.z_expression(torch.zeros(60))


# --- whole model -----------------------------------------------------------------------------------------------------


def test_render_composes_over_the_background(model):
    data = inputs(model)
    camera = Camera.orbit(24, 20, distance=0.8)
    black = model.render(camera, data, backend="torch")
    blue = model.render(camera, data, background=(0.0, 0.0, 1.0), backend="torch")
    assert black.image.shape == (20, 24, 3)
    expected = black.image + (1 - black.alpha)[..., None] * torch.tensor([0.0, 0.0, 1.0])
    torch.testing.assert_close(blue.image, expected)
    assert black.alpha.max() > 0.9
    assert black.alpha[0, 0] == 0


def test_wrong_code_lengths_are_named(model):
    data = dataclasses.replace(inputs(model), z_id=torch.zeros(3))
    with pytest.raises(ShapeError, match="z_id"):
        model.render(Camera.orbit(8, 8), data, backend="torch")


def test_gradients_of_the_whole_chain(head):
    """Directional derivatives of a picture loss against central differences, float64, reference rasteriser."""
    torch.manual_seed(7)
    model = GRMM(head, PRESETS["tiny"].replace(grid=16, decoder_channels=(8,), decoder_grid=8, view_stage=4)).double()
    randomise(model, 0.2)
    data = inputs(model)
    given = {name: getattr(data, name).requires_grad_(True) for name in ("z_id", "z_exp", "shape", "expression", "pose")}
    camera = Camera.orbit(20, 18, yaw=30.0, distance=0.8)
    target = torch.rand(18, 20, 3, dtype=torch.float64)

    def loss() -> torch.Tensor:
        r = model.render(camera, data, background=(0.2, 0.5, 0.1), backend="torch", lit_later=True)  # the shade has no gradient
        return (r.image - target).square().mean() + 0.3 * (r.raw - target).square().mean() + r.alpha.mean() + r.depth.mean()

    model.zero_grad()
    loss().backward()
    leaves = given | dict(model.named_parameters())
    generator = torch.Generator().manual_seed(8)
    step = 1e-6
    for name, leaf in leaves.items():
        direction = torch.randn(leaf.shape, generator=generator, dtype=torch.float64)
        direction /= direction.norm()
        assert leaf.grad is not None or name == "aligned_codes", name
        if leaf.grad is None:
            continue
        with torch.no_grad():
            leaf += step * direction
            above = loss()
            leaf -= 2 * step * direction
            below = loss()
            leaf += step * direction
        expected = float((above - below) / (2 * step))
        got = float((leaf.grad * direction).sum())
        assert got == pytest.approx(expected, rel=2e-3, abs=2e-7), name


def test_the_light_of_the_studio_is_for_data_of_the_studio():
    """Without it a turned neck changes no color; the paper's form has none."""
    head = small_head()
    assert not PRESETS["paper"].turned_light
    for turned in (True, False):
        model = GRMM(head, PRESETS["tiny"].replace(turned_light=turned))
        vertices, pose = torch.tensor(head.v_template, dtype=torch.float32), torch.zeros(5, 3)
        assert model.turned_shade(vertices, pose) is None
        pose[1, 1] = 0.5
        shade = model.turned_shade(vertices, pose)
        assert (shade is not None) == turned
        assert shade is None or shade.shape == (model.gaussian_count, 1)
