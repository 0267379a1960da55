from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from model_fixtures import RADIUS, SHAPES, TEETH, small_head

from grmm_core.camera import Camera
from grmm_core.errors import ConfigError, ShapeError
from grmm_core.expressions import ALIGNED_NAMES
from grmm_core.model.config import PRESETS, GRMMConfig
from grmm_core.model.decoders import MapDecoder, texel_reader
from grmm_core.model.grmm import GRMM, euler_to_rotvec
from grmm_core.model.refine import RefinementNetwork, depth_range, normalise_depth
from grmm_core.model.sparse import FixedSparse
from grmm_core.model.texels import (
    TexelAnchor,
    matrix_to_quaternion,
    multiply_quaternions,
    place_gaussians,
    rotate,
    texel_layout,
)
from grmm_core.splat import RasterOutput
from grmm_core.splat.reference import rotation_matrices


@pytest.fixture(scope="module")
def head():
    return small_head()


@pytest.fixture
def model(head):
    torch.manual_seed(0)
    return GRMM(head, PRESETS["tiny"])


def randomise(model: GRMM, scale: float = 0.3) -> None:
    """Move every parameter, so that layers that start at zero take part."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in model.parameters():
            noise = torch.randn(parameter.shape, generator=generator, dtype=torch.float64).to(parameter.dtype)
            parameter.add_(noise * scale / max(1.0, parameter[0].numel() ** 0.5))


def inputs(model: GRMM, seed: int = 2) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(model.dtype)

    return {
        "shape": normal(SHAPES), "expression": 0.3 * normal(52), "pose": 0.1 * normal(5, 3),
        "z_id": normal(model.z_id_size), "z_exp": normal(model.z_exp_size),
    }  # fmt: skip


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
        ({"colour": 1}, "colour"),
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


# --- texels ----------------------------------------------------------------------------------------------------------


def test_texel_positions_match_their_uv(head):
    layout = texel_layout(head.uv, head.uv_faces, 32)
    uv = np.einsum("nk,nkx->nx", layout.barycentric, head.uv[head.uv_faces[layout.face]])
    expected = np.stack([layout.texel % 32 + 0.5, layout.texel // 32 + 0.5], -1) / 32
    np.testing.assert_allclose(uv, expected, atol=1e-6)
    # the island is the square 0.05..0.95: texel centres 2..29 of 0..31 lie in it
    assert len(layout) == 28 * 28


def test_texels_of_overlapping_triangles_belong_to_the_first_face():
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float64)
    layout = texel_layout(uv, np.array([[0, 1, 2], [0, 1, 2]]), 8)
    assert (layout.face == 0).all()
    assert len(layout) == 36  # centres on the diagonal count


def test_empty_uv_map_is_an_error():
    with pytest.raises(ShapeError, match="finer grid"):
        texel_layout(np.zeros((3, 2)), np.array([[0, 1, 2]]), 8)


def test_frames_of_a_plane_are_exact():
    """On a flat, sheared plane dP/du and dP/dv are constants."""
    u, v = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 4))
    uv = np.stack([u, v], -1).reshape(-1, 2)
    along, across = np.array([0.3, 0.0, 0.1]), np.array([0.05, 0.2, 0.0])
    vertices = uv[:, :1] * along + uv[:, 1:] * across + np.array([1.0, 2.0, 3.0])
    index = np.arange(20).reshape(4, 5)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    layout = texel_layout(uv, faces, 8)
    anchor = TexelAnchor(layout, faces, uv, faces, 20).double()
    frames = anchor(torch.from_numpy(vertices))
    expected = np.stack([layout.texel % 8 + 0.5, layout.texel // 8 + 0.5], -1) / 8
    np.testing.assert_allclose(frames.positions.numpy(), expected @ [along, across] + [1, 2, 3], atol=1e-6)
    normal = np.cross(along, across)
    normal /= np.linalg.norm(normal)
    tangent = along / np.linalg.norm(along)
    turned = rotation_matrices(frames.quats).numpy()
    axes = np.stack([tangent, np.cross(normal, tangent), normal], -1)
    np.testing.assert_allclose(turned, np.broadcast_to(axes, turned.shape), atol=1e-6)
    height = np.linalg.norm(np.cross(tangent, across))
    sides = np.array([np.linalg.norm(along), height]) / 8
    np.testing.assert_allclose(frames.sizes.numpy(), np.broadcast_to(sides, (len(layout), 2)), atol=1e-6)


def test_mirrored_islands_keep_the_normal_outside(head):
    mirrored = head.uv * np.array([-1, 1], np.float32) + np.array([1, 0], np.float32)
    layout = texel_layout(mirrored, head.uv_faces, 32)
    anchor = TexelAnchor(layout, head.faces, mirrored, head.uv_faces, head.vertex_count)
    frames = anchor(torch.from_numpy(head.v_template.copy()))
    normals = rotate(frames.quats, torch.tensor([0.0, 0.0, 1.0]).expand(len(layout), 3))
    assert ((normals * frames.positions).sum(-1) > 0.9 * RADIUS).all()


def test_gaussians_turn_with_the_mesh(model):
    """A rotation of the mesh rotates means and orientations and leaves scales alone, offsets included."""
    model = model.double()
    randomise(model)
    vertices = torch.from_numpy(model.head_model.v_template.astype(np.float64))
    data = inputs(model)
    offsets = model.offsets(data["z_id"], data["z_exp"])
    turn = torch.tensor([0.9, 0.2, -0.3, 0.1], dtype=torch.float64)
    turn = turn / turn.norm()
    before = model.geometry(vertices, offsets)
    after = model.geometry(rotate(turn.expand(len(vertices), 4), vertices), offsets)
    count = model.gaussian_count
    torch.testing.assert_close(after.means, rotate(turn.expand(count, 4), before.means), atol=1e-8, rtol=0)
    torch.testing.assert_close(after.scales, before.scales, atol=1e-8, rtol=0)
    expected = rotation_matrices(multiply_quaternions(turn.expand(count, 4), before.quats))
    torch.testing.assert_close(rotation_matrices(after.quats), expected, atol=1e-6, rtol=0)


def test_zero_offsets_leave_gaussians_on_the_surface(model):
    frames = model.anchor(torch.from_numpy(model.head_model.v_template.copy()))
    zero = torch.zeros(model.gaussian_count, 10)
    placed = place_gaussians(frames, zero, 0.01, 0.2, 1.6, 0.6, 0.35)
    torch.testing.assert_close(placed.means, frames.positions)
    torch.testing.assert_close(placed.scales[:, :2], frames.sizes * 0.6)
    up = zero.clone()
    up[:, 2] = 1.0  # one centimetre along the normal, less the soft limit's 0.08 %
    raised = place_gaussians(frames, up, 0.01, 0.2, 1.6, 0.6, 0.35).means
    torch.testing.assert_close((raised - frames.positions).norm(dim=-1), torch.full((len(zero),), 0.01), rtol=2e-3, atol=0)
    assert raised.norm(dim=-1).mean() > frames.positions.norm(dim=-1).mean() + 0.009


def test_compiled_placing_is_the_plain_one_with_its_gradients(model):
    randomise(model)
    data = inputs(model)
    start = torch.from_numpy(model.head_model.v_template.copy())
    offsets = model.offsets(data["z_id"], data["z_exp"]).detach()
    offsets = offsets + 0.3 * torch.randn(offsets.shape, generator=torch.Generator().manual_seed(9))
    for log_limit in (1.6, None):
        settings = (0.01, 0.2, log_limit, 0.6, 0.35)
        results = []
        for compiled in (True, False):
            v, o = start.clone().requires_grad_(True), offsets.clone().requires_grad_(True)
            placed = model.anchor.place(v, o, *settings) if compiled else place_gaussians(model.anchor(v), o, *settings)
            generator = torch.Generator().manual_seed(10)
            parts = (placed.means, placed.quats, placed.scales)
            sum((part * torch.randn(part.shape, generator=generator)).sum() for part in parts).backward()
            results.append([*(part.detach() for part in parts), v.grad, o.grad])
        for name, fast, plain in zip(("means", "quats", "scales", "vertices", "offsets"), *results, strict=True):
            tolerance = 2e-4 * float(plain.abs().max())
            torch.testing.assert_close(fast, plain, rtol=2e-4, atol=tolerance, msg=lambda m, n=name: n + m)


def test_quaternions_of_random_rotations():
    generator = torch.Generator().manual_seed(3)
    quats = torch.randn(500, 4, generator=generator, dtype=torch.float64)
    quats = torch.cat([quats, torch.eye(4, dtype=torch.float64)])  # half turns, where one-formula conversions fail
    matrices = rotation_matrices(quats)
    torch.testing.assert_close(rotation_matrices(matrix_to_quaternion(matrices)), matrices, atol=1e-12, rtol=0)


def test_fixed_sparse_is_the_dense_product_and_its_gradient():
    rng = np.random.default_rng(4)
    rows, columns, values = rng.integers(0, 7, 30), rng.integers(0, 5, 30), rng.normal(size=30)
    dense = np.zeros((7, 5))
    np.add.at(dense, (rows, columns), values)
    operator = FixedSparse(rows, columns, values, (7, 5)).double()
    x = torch.randn(5, 3, dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(operator(x), torch.from_numpy(dense) @ x, atol=1e-6, rtol=0)
    weight = torch.randn(7, 3, dtype=torch.float64)
    (operator(x) * weight).sum().backward()
    torch.testing.assert_close(x.grad, torch.from_numpy(dense).T @ weight, atol=1e-6, rtol=0)


def test_texel_reader_is_bilinear_enlargement():
    coarse = torch.randn(2, 8, 8)
    full = torch.nn.functional.interpolate(coarse[None], size=(32, 32), mode="bilinear", align_corners=False)[0]
    texel = np.arange(0, 1024, 7)
    read = texel_reader(texel, 32, 8)(coarse.flatten(1).T)
    torch.testing.assert_close(read, full.flatten(1).T[torch.from_numpy(texel)], atol=1e-5, rtol=0)


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
    data = inputs(model)
    turns = torch.zeros(1, 3)
    result = model.displacement(data["z_id"][None], data["z_exp"][None], turns, turns, data["expression"][None])
    assert result.shape == (1, model.head_model.vertex_count, 3)
    assert not result.any()


def test_expression_does_not_move_teeth_but_identity_does(model):
    randomise(model)
    data = inputs(model)
    zero = torch.zeros(1, 3)
    z_id = data["z_id"][None]

    def displacement(z_id, z_exp, expression):
        return model.displacement(z_id, z_exp, zero, zero, expression)[0].detach().numpy()

    one = displacement(z_id, data["z_exp"][None], data["expression"][None])
    other = displacement(z_id, -data["z_exp"][None], -data["expression"][None])
    moved = np.abs(one - other).max(1)
    assert (moved[TEETH] == 0).all()
    assert (np.delete(moved, TEETH) > 0).all()
    person = displacement(-z_id, data["z_exp"][None], data["expression"][None])
    assert (np.abs(one - person).max(1)[TEETH] > 0).all()


def test_displacement_is_in_millimetres(model):
    with torch.no_grad():
        model.mesh_decoder.identity[-1].bias.fill_(1.0)
    zero = torch.zeros(1, 3)
    result = model.displacement(torch.zeros(1, 6), torch.zeros(1, 5), zero, zero, torch.zeros(1, 52))
    torch.testing.assert_close(result, torch.full_like(result, 1e-3))


def test_rotation_vectors():
    generator = torch.Generator().manual_seed(6)
    euler = torch.randn(200, 3, generator=generator, dtype=torch.float64) * 1.5
    vectors = euler_to_rotvec(euler)
    skew = torch.zeros(200, 3, 3, dtype=torch.float64)
    x, y, z = vectors.unbind(-1)
    skew[:, 2, 1], skew[:, 1, 2], skew[:, 0, 2], skew[:, 2, 0], skew[:, 1, 0], skew[:, 0, 1] = x, -x, y, -y, z, -z
    from grmm_core.head.skinning import euler_matrices

    torch.testing.assert_close(torch.linalg.matrix_exp(skew), euler_matrices(euler), atol=1e-10, rtol=0)
    assert vectors.norm(dim=-1).max() <= math.pi + 1e-9
    rest = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(euler_to_rotvec, rest)
    torch.testing.assert_close(jacobian, torch.eye(3, dtype=torch.float64))


# --- decoders and codes ----------------------------------------------------------------------------------------------


def test_opacity_depends_on_identity_only_and_appearance_on_the_view(model):
    randomise(model)
    data = inputs(model)
    front, side = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
    one = model.gaussians(torch.from_numpy(model.head_model.v_template.copy()), data["z_id"], data["z_exp"], front)
    other = model.gaussians(torch.from_numpy(model.head_model.v_template.copy()), data["z_id"], -data["z_exp"], side)
    torch.testing.assert_close(one.opacities, other.opacities)
    assert ((one.opacities > 0) & (one.opacities < 1)).all()
    assert (one.colors - other.colors).abs().max() > 1e-4
    assert (one.features - other.features).abs().max() > 1e-4
    assert (one.means - other.means).abs().max() > 1e-5
    added = model.expression_colours(data["z_id"], data["z_exp"])
    torch.testing.assert_close(model.appearance(data["z_id"], front)[0] + added, one.colors)


def test_expression_maps_colour_by_expression_with_a_gain_by_identity(model):
    randomise(model)
    maps = model.decoders.expression
    z_id, z_exp = inputs(model)["z_id"], inputs(model)["z_exp"]
    weights = (maps.weights.weight @ z_exp) * (1 + maps.gains.weight @ z_id)
    expected = torch.einsum("k,knc->nc", weights, maps.maps.view(len(weights), -1, 3))
    torch.testing.assert_close(model.expression_colours(z_id, z_exp), expected)
    assert expected.abs().max() > 1e-3
    assert not model.expression_colours(z_id, 0 * z_exp).any()
    assert not torch.equal(model.expression_colours(-z_id, z_exp), expected)


def test_without_expression_maps_nothing_is_added():
    plain = GRMM(small_head(), PRESETS["tiny"].replace(expression_maps=0))
    assert plain.decoders.expression is None
    added = plain.expression_colours(torch.ones(plain.z_id_size), torch.ones(plain.z_exp_size))
    assert added.shape == (1, 3)
    assert not added.any()


def test_view_direction_enters_at_its_stage():
    decoder = MapDecoder(3, 2, 4, (8, 8, 8), view_stage=8)
    assert [stage.in_channels for stage in decoder.stages] == [8, 11, 8]
    assert decoder(torch.zeros(1, 3), torch.zeros(1, 3)).shape == (1, 2, 32, 32)


def test_basis_maps_are_linear_in_the_identity_code(model):
    decoders = model.decoders
    for name, width in (("position", 3), ("colour", 3), ("opacity", 1)):
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
    assert model.z_identity(torch.zeros(6), data["shape"]) is data["shape"]
    torch.testing.assert_close(model.z_expression(torch.zeros(60), expression=data["expression"]), data["expression"])
    with pytest.raises(ConfigError):
        model.z_expression(torch.zeros(60))


# --- refinement ------------------------------------------------------------------------------------------------------


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


# --- whole model -----------------------------------------------------------------------------------------------------


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


def test_render_composes_over_the_background(model):
    data = inputs(model)
    camera = Camera.orbit(24, 20, distance=0.8)
    black = model.render(camera, **data, backend="torch")
    blue = model.render(camera, **data, background=(0.0, 0.0, 1.0), backend="torch")
    assert black.image.shape == (20, 24, 3)
    expected = black.image + (1 - black.alpha)[..., None] * torch.tensor([0.0, 0.0, 1.0])
    torch.testing.assert_close(blue.image, expected)
    assert black.alpha.max() > 0.9
    assert black.alpha[0, 0] == 0


def test_wrong_code_lengths_are_named(model):
    data = inputs(model) | {"z_id": torch.zeros(3)}
    with pytest.raises(ShapeError, match="z_id"):
        model.render(Camera.orbit(8, 8), **data, backend="torch")


def test_gradients_of_the_whole_chain(head):
    """Directional derivatives of a picture loss against central differences, float64, reference rasteriser."""
    torch.manual_seed(7)
    model = GRMM(head, PRESETS["tiny"].replace(grid=16, decoder_channels=(8,), decoder_grid=8, view_stage=4)).double()
    randomise(model, 0.2)
    data = {name: value.requires_grad_(True) for name, value in inputs(model).items()}
    camera = Camera.orbit(20, 18, yaw=30.0, distance=0.8)
    target = torch.rand(18, 20, 3, dtype=torch.float64)

    def loss() -> torch.Tensor:
        r = model.render(camera, **data, background=(0.2, 0.5, 0.1), backend="torch")
        return (r.image - target).square().mean() + 0.3 * (r.raw - target).square().mean() + r.alpha.mean() + r.depth.mean()

    model.zero_grad()
    loss().backward()
    leaves = data | dict(model.named_parameters())
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
