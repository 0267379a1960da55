"""Texels: where Gaussians sit on the mesh, their frames, and reading maps at them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from model_fixtures import RADIUS, inputs, randomise
from without_torch import run_without_torch

from grmm_core.errors import ShapeError
from grmm_core.geometry.rotations import multiply_quaternions, quaternion_to_matrix
from grmm_core.geometry.tensor_rotations import matrix_to_quaternion, rotate
from grmm_core.model.layout import map_reader, texel_layout
from grmm_core.model.sparse import FixedSparse
from grmm_core.model.texels import (
    TexelAnchor,
    place_gaussians,
)


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
    anchor = TexelAnchor(layout, faces, faces, 20).double()
    frames = anchor(torch.from_numpy(vertices))
    expected = np.stack([layout.texel % 8 + 0.5, layout.texel // 8 + 0.5], -1) / 8
    np.testing.assert_allclose(frames.positions.numpy(), expected @ [along, across] + [1, 2, 3], atol=1e-6)
    normal = np.cross(along, across)
    normal /= np.linalg.norm(normal)
    tangent = along / np.linalg.norm(along)
    turned = quaternion_to_matrix(frames.quats).numpy()
    axes = np.stack([tangent, np.cross(normal, tangent), normal], -1)
    np.testing.assert_allclose(turned, np.broadcast_to(axes, turned.shape), atol=1e-6)
    height = np.linalg.norm(np.cross(tangent, across))
    sides = np.array([np.linalg.norm(along), height]) / 8
    np.testing.assert_allclose(frames.sizes.numpy(), np.broadcast_to(sides, (len(layout), 2)), atol=1e-6)


def test_mirrored_islands_keep_the_normal_outside(head):
    mirrored = head.uv * np.array([-1, 1], np.float32) + np.array([1, 0], np.float32)
    layout = texel_layout(mirrored, head.uv_faces, 32)
    anchor = TexelAnchor(layout, head.faces, head.uv_faces, head.vertex_count)
    frames = anchor(torch.from_numpy(head.v_template.copy()))
    assert ((frames.normals * frames.positions).sum(-1) > 0.9 * RADIUS).all()


def test_gaussians_turn_with_the_mesh(model):
    """A rotation of the mesh rotates means and orientations and leaves scales alone, offsets included."""
    model = model.double()
    randomise(model)
    vertices = torch.from_numpy(model.head_model.v_template.astype(np.float64))
    data = inputs(model)
    offsets = model.offsets(data.z_id, data.z_exp)
    turn = torch.tensor([0.9, 0.2, -0.3, 0.1], dtype=torch.float64)
    turn = turn / turn.norm()
    before = model.geometry(vertices, offsets)
    after = model.geometry(rotate(turn.expand(len(vertices), 4), vertices), offsets)
    count = model.gaussian_count
    torch.testing.assert_close(after.means, rotate(turn.expand(count, 4), before.means), atol=1e-8, rtol=0)
    torch.testing.assert_close(after.scales, before.scales, atol=1e-8, rtol=0)
    expected = quaternion_to_matrix(multiply_quaternions(turn.expand(count, 4), before.quats))
    torch.testing.assert_close(quaternion_to_matrix(after.quats), expected, atol=1e-6, rtol=0)


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
    offsets = model.offsets(data.z_id, data.z_exp).detach()
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


def test_gaussians_are_placed_where_torch_is_missing(model, tmp_path):
    vertices = torch.from_numpy(model.head_model.v_template.copy())
    offsets = 0.3 * torch.randn(len(model.anchor.barycentric), 10, generator=torch.Generator().manual_seed(11))
    inputs = model.anchor.corners(vertices), model.anchor.texel_corners, model.anchor.barycentric, offsets
    np.savez(tmp_path / "inputs.npz", *(tensor.numpy() for tensor in inputs))
    script = """
        import numpy as np
        from grmm_core.compute.threads import for_rows
        from grmm_core.model.placing import place_forward
        inputs = np.load("inputs.npz")
        arrays = [inputs[name] for name in inputs.files]
        placed = [np.empty((len(arrays[-1]), size), np.float32) for size in (3, 4, 3)]
        settings = tuple(map(np.float32, (0.01, 0.2, 1.6, 0.6 / GRID, 0.35 / GRID)))
        for_rows(place_forward, len(arrays[-1]), *arrays, settings, *placed)
        np.savez("placed.npz", *placed)
    """
    run_without_torch(script.replace("GRID", str(model.anchor.grid)), tmp_path)
    expected = place_gaussians(model.anchor(vertices), offsets, 0.01, 0.2, 1.6, 0.6, 0.35)
    with np.load(tmp_path / "placed.npz") as placed:
        for name, wanted in zip(placed.files, expected, strict=True):
            np.testing.assert_allclose(placed[name], wanted, rtol=2e-4, atol=2e-4 * float(wanted.abs().max()))


def test_quaternions_of_random_rotations():
    generator = torch.Generator().manual_seed(3)
    quats = torch.randn(500, 4, generator=generator, dtype=torch.float64)
    quats = torch.cat([quats, torch.eye(4, dtype=torch.float64)])  # half turns, where one-formula conversions fail
    matrices = quaternion_to_matrix(quats)
    torch.testing.assert_close(quaternion_to_matrix(matrix_to_quaternion(matrices)), matrices, atol=1e-12, rtol=0)


def test_fixed_sparse_is_the_dense_product_and_its_gradient():
    rng = np.random.default_rng(4)
    rows, columns, values = rng.integers(0, 7, 30), rng.integers(0, 5, 30), rng.normal(size=30)
    dense = np.zeros((7, 5))
    np.add.at(dense, (rows, columns), values)
    operator = FixedSparse((rows, columns, values), (7, 5)).double()
    x = torch.randn(5, 3, dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(operator(x), torch.from_numpy(dense) @ x, atol=1e-6, rtol=0)
    weight = torch.randn(7, 3, dtype=torch.float64)
    (operator(x) * weight).sum().backward()
    torch.testing.assert_close(x.grad, torch.from_numpy(dense).T @ weight, atol=1e-6, rtol=0)


def test_map_reader_is_bilinear_enlargement():
    coarse = torch.randn(2, 8, 8)
    full = torch.nn.functional.interpolate(coarse[None], size=(32, 32), mode="bilinear", align_corners=False)[0]
    texel = np.arange(0, 1024, 7)
    read = FixedSparse(map_reader(texel, 32, 8), (len(texel), 64))(coarse.flatten(1).T)
    torch.testing.assert_close(read, full.flatten(1).T[torch.from_numpy(texel)], atol=1e-5, rtol=0)
