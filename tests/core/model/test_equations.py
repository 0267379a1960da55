"""The paper's equations written out with numpy, against the code; and the table that says where each one is."""

from __future__ import annotations

import ast
import importlib
import re

import numpy as np
import pytest
import torch
from model_fixtures import TEETH, inputs, randomise, small_head

from grmm_core.geometry.camera import Camera
from grmm_core.geometry.rotations import euler_to_matrix, quaternion_to_matrix
from grmm_core.geometry.tensor_rotations import euler_to_rotvec
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM, JAW, NECK
from grmm_core.splat import rasterize
from grmm_core.training.losses import LossWeights, Target, code_loss, scale_loss, ssim, total_loss, vertex_laplacian

SLOPE = 0.2


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    made = GRMM(small_head(), PRESETS["tiny"].replace(scale_log_limit=None)).double()
    randomise(made)
    return made


def array(tensor):
    return tensor.detach().numpy()


def layers(network, x, last=False):
    """Fully connected layers with leaky rectifiers between them, after the last one too when asked."""
    linear = [module for module in network if isinstance(module, torch.nn.Linear)]
    for number, layer in enumerate(linear):
        x = x @ array(layer.weight).T + (array(layer.bias) if layer.bias is not None else 0.0)
        if last or number < len(linear) - 1:
            x = np.where(x > 0, x, SLOPE * x)
    return x


def test_equation_2_cameras_in_head_space():
    rotation = euler_to_matrix(torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)).numpy()
    translation = np.array([0.02, -0.01, 0.05])
    camera = Camera.orbit(64, 48, yaw=20.0, pitch=5.0, distance=0.7)
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    E = camera.world_to_camera[:3]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    point = np.array([0.01, 0.03, 0.08, 1.0])
    expected = K @ E @ np.concatenate([rotation @ point[:3] + translation, [1.0]])
    moved = camera.transformed(matrix)
    found = K @ moved.world_to_camera[:3] @ point
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_equations_5_to_11_of_the_mesh_decoder(model):
    data = inputs(model)
    decoder = model.mesh_decoder
    z_id, z_exp = array(data.z_id), array(data.z_exp)
    turns = array(euler_to_rotvec(data.pose[[NECK, JAW]]))
    alpha_exp = np.zeros(100)
    alpha_exp[:52] = array(data.expression)

    f_base = layers(decoder.shared, np.concatenate([z_id, turns[0], turns[1]]), last=True)  # eq. 5
    v_id = layers(decoder.identity, f_base)  # eq. 6
    f_exp = np.concatenate([f_base, z_exp])  # eq. 7
    gamma, beta = np.split(layers(decoder.film, alpha_exp), 2)  # eq. 8
    v_exp = layers(decoder.expression, f_exp + gamma * f_exp + beta)  # eq. 9, 10
    M_face = np.ones((model.head_model.vertex_count, 1))
    M_face[TEETH] = 0.0
    v_delta = 1e-3 * (v_id.reshape(-1, 3) + M_face * v_exp.reshape(-1, 3))  # of eq. 11, millimetres to metres

    found = model.displacement(data)
    assert np.abs(v_delta).max() > 1e-5
    np.testing.assert_allclose(array(found), v_delta, atol=1e-12)

    # v_d = v_rec + v_delta: with all joints at rest, skinning changes nothing
    head = model.head_model
    v_rec = head.v_template + head.shape_dirs @ array(data.shape) + head.expression_dirs @ array(data.expression)
    still = torch.zeros(5, 3, dtype=torch.float64)
    vertices, _ = model.head(data.shape, data.expression, still, found)
    np.testing.assert_allclose(array(vertices), v_rec + v_delta, atol=1e-6)  # the head's arrays are float32


def test_equation_12_attributes_in_the_tangent_frame(model):
    data, c = inputs(model), model.config
    frames = model.anchor(torch.from_numpy(model.head_model.v_template.astype(np.float64)))
    offsets = model.offsets(data.z_id, data.z_exp)
    placed = model.geometry(torch.from_numpy(model.head_model.v_template.astype(np.float64)), offsets)
    delta_p, delta_r, delta_s = np.split(array(offsets), (3, 7), axis=1)
    axes = array(quaternion_to_matrix(frames.quats))
    metres = delta_p * c.position_unit_mm * 1e-3
    limited = metres / np.sqrt(1 + (metres / (c.position_limit_mm * 1e-3)) ** 2)
    p = array(frames.positions) + np.einsum("nij,nj->ni", axes, limited)
    turn = torch.from_numpy(delta_r + np.array([1.0, 0, 0, 0]))
    sizes = array(frames.sizes)
    s = np.concatenate([sizes * c.texel_scale, sizes.min(1, keepdims=True) * c.normal_scale], 1) * np.exp(delta_s)
    np.testing.assert_allclose(array(placed.means), p, atol=1e-7)
    np.testing.assert_allclose(array(placed.scales), s, atol=1e-7)
    expected = axes @ array(quaternion_to_matrix(turn))
    np.testing.assert_allclose(array(quaternion_to_matrix(placed.quats)), expected, atol=1e-5)


def test_equations_13_and_14_rasterise_then_refine(model):
    data = inputs(model)
    camera = Camera.orbit(26, 22, yaw=15.0, distance=0.8)
    out = model.render(camera, data, backend="torch")
    raster = rasterize(out.gaussians, camera, backend="torch")
    covered = array(raster.alpha) > 0.5
    depth = array(raster.depth)
    low, high = depth[covered].min(), depth[covered].max()
    normalised = np.clip((depth - low) / (high - low), 0, 1) * array(raster.alpha)  # min-max, premultiplied as the colors are
    refined = model.refinement(raster.rgb, raster.features, torch.from_numpy(normalised), raster.alpha)
    np.testing.assert_allclose(array(out.raw), array(raster.rgb), atol=1e-12)
    np.testing.assert_allclose(array(out.image), array(refined), atol=1e-9)
    assert np.abs(array(out.image - out.raw)).max() > 1e-3


def test_equations_15_to_18_of_the_objective(model):
    data = inputs(model)
    camera = Camera.orbit(26, 22, yaw=15.0, distance=0.8)
    out = model.render(camera, data, backend="torch")
    random = torch.Generator().manual_seed(3)
    metres = 0.8 + 0.1 * torch.rand(22, 26, generator=random, dtype=torch.float64)
    metres[:, :9] = 0.0  # unknown there
    target = Target(torch.rand(22, 26, 3, generator=random, dtype=torch.float64), depth=metres)

    def perceptual(a, b):
        return (a - b).square().mean().sqrt()

    laplacian = vertex_laplacian(torch.from_numpy(model.head_model.faces.copy()), model.head_model.vertex_count).double()
    codes = (data.z_id, data.z_exp)
    loss, terms = total_loss(out, target, laplacian, LossWeights(), True, perceptual)

    def L_rec(picture):  # eq. 16
        L_l1 = (picture - target.image).abs().mean()
        return 0.8 * L_l1 + 0.2 * (1 - ssim(picture, target.image)) + 0.04 * perceptual(picture, target.image)

    s = array(out.gaussians.scales) * 1e3  # millimetres
    l_s = np.where(s < 0.1, 1 / np.maximum(s, 1e-7), np.where(s > 10.0, (s - 10.0) ** 2, 0.0))  # eq. 18
    assert l_s.max() > 0
    assert scale_loss(out.gaussians.scales * 1e3).item() == pytest.approx(l_s.mean(), rel=1e-9)
    L_z = sum((code**2).sum() for code in map(array, codes))
    assert code_loss(*codes).item() == pytest.approx(L_z, rel=1e-9)
    rough = array(laplacian(out.mesh.displacement * 1e3))
    L_reg = 0.1 * l_s.mean() + 0.001 * L_z + 0.01 * (rough**2).sum(1).mean()  # eq. 17
    known = (array(metres) > 0) & (array(out.alpha) > 0.5)
    assert 0 < known.sum() < (array(out.alpha) > 0.5).sum()
    L_depth = (((array(out.depth) - array(metres))[known] * 10.0) ** 2).mean()  # decimetres
    assert terms["depth"].item() == pytest.approx(L_depth, rel=1e-9)
    expected = (L_rec(out.image) + L_rec(out.raw)).item() + 0.5 * L_depth + L_reg  # eq. 15
    assert loss.item() == pytest.approx(expected, rel=1e-9)


def _found(name):
    """Whether a dotted name of the table exists in the core; the class is looked for in every module of the model."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module("grmm_core." + ".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        rest = parts[cut:]
        return not rest or _reach(thing, rest)
    modules = ["model.grmm", "model.mesh_decoder", "model.texels", "model.decoders", "model.refine", "model.config"]
    return any(_reach(importlib.import_module(f"grmm_core.{module}"), parts) for module in modules)


def _reach(thing, names):
    for name in names:
        fields = getattr(thing, "__dataclass_fields__", {})
        if name not in fields and not hasattr(thing, name):
            return False
        thing = getattr(thing, name, None)
    return True


def test_the_table_names_what_exists(repository):
    text = (repository / "docs" / "equations.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| ") and line.count("|") == 5]
    rows = [row for row in rows if not row[0].strip().startswith("eq")]
    tests = {}
    for path in (repository / "tests").rglob("test_*.py"):
        names = {node.name for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.FunctionDef)}
        tests[path.name] = names
    every = set().union(*tests.values())
    numbers = set()
    for equation, _, code, checked in rows:
        for part in re.split(r",\s*", equation.strip()):
            low, _, high = part.partition("-")
            if low.isdigit():
                numbers |= set(range(int(low), int(high or low) + 1))
        for name in re.findall(r"`([^`]+)`", code):
            assert _found(name), f"{name} is in the table and not in the code"
        assert "`" in checked, f"no test for {equation}"
        for name in re.findall(r"`([^`]+)`", checked):
            file, _, function = name.partition("::")
            known = name in every or (file in tests and (not function or function in tests[file]))
            assert known, f"{name} is in the table and no test"
    assert numbers == set(range(1, 22))
