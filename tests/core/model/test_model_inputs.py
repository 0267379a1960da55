"""From a person and controls to model inputs, the chain in batches, portraits, levels of detail."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
import pytest
import torch
from model_fixtures import EXPRESSIONS, SHAPES, inputs, randomise, small_head
from PIL import Image

from grmm_core.controls.frame import Controls, resolve
from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.errors import ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.model.config import PRESETS
from grmm_core.model.detail import texel_blocks
from grmm_core.model.grmm import GRMM
from grmm_core.model.inputs import ModelInputs, Person
from grmm_core.model.portrait import portrait, portrait_camera, thumbnail

SMILE = EXPRESSIONS - 1  # a component that the test turns a joint with


@pytest.fixture(scope="module")
def head():
    made = small_head()
    turns = np.zeros((EXPRESSIONS, 5, 3), np.float32)
    turns[SMILE, 2, 0] = 0.3
    return dataclasses.replace(made, expression_pose=turns)


@pytest.fixture(scope="module")
def model(head):
    torch.manual_seed(0)
    made = GRMM(head, PRESETS["tiny"])
    randomise(made)
    return made


@pytest.fixture(scope="module")
def person(model):
    rng = np.random.default_rng(3)
    return Person(*(rng.normal(size=n).astype(np.float32) for n in (model.z_id_size, SHAPES)))


# --- a person and controls -------------------------------------------------------------------------------------------


def test_person_and_controls_add_up(model, person):
    own = dataclasses.replace(person, z_exp=np.full(3, 0.5, np.float32), expression=np.eye(1, 4, 1, dtype=np.float32)[0])
    controls = Controls().set_named({"jawOpen": 0.5, "expression.1": 0.25, "z_id.2": 1.0, "shape.0": 2.0, "neck.y": 0.1})
    controls.residual_strength = 0.5
    found = model.input_space().inputs(own, controls)
    np.testing.assert_allclose(found.z_id - person.z_id, np.eye(1, model.z_id_size, 2)[0])
    np.testing.assert_allclose(found.shape - person.shape, 2.0 * np.eye(1, SHAPES)[0], atol=1e-6)
    offset = np.pad(own.z_exp, (0, model.z_exp_size - 3))
    code = 0.5 * model.aligned_codes[ALIGNED_NAMES.index("jawOpen")].detach().numpy() + offset
    np.testing.assert_allclose(found.z_exp, 0.5 * code, atol=1e-6)
    expected = np.zeros(EXPRESSIONS)
    expected[[1, ALIGNED_NAMES.index("jawOpen")]] = 1.25, 0.5
    np.testing.assert_allclose(found.expression, expected)
    assert found.pose[1, 1] == pytest.approx(0.1)
    assert found.strength == 0.5


def test_a_resting_expression_turns_joints_as_the_same_controls_do(model, person):
    resting = np.zeros(EXPRESSIONS, np.float32)
    resting[SMILE] = 0.8
    space = model.input_space()
    own = space.inputs(dataclasses.replace(person, expression=resting), Controls())
    driven = space.inputs(person, Controls().set_named({f"expression.{SMILE}": 0.8}))
    assert own.pose[2, 0] == pytest.approx(0.24)
    assert own.mesh_key == driven.mesh_key


def test_captured_frames_go_the_same_way_as_controls(model, person):
    space, controls = model.input_space(), Controls().set_named({"laugh": 0.7, "eyes.yaw": 0.2})
    performed = resolve(controls, model.head_model)
    assert space.frame(person, performed).mesh_key == space.inputs(person, controls).mesh_key
    arrays = (person.z_id, person.shape, performed.expression, performed.pose, performed.aligned)
    tensors = model.performed(*(torch.from_numpy(array) for array in arrays))
    np.testing.assert_allclose(tensors.z_exp.detach(), space.inputs(person, controls).z_exp, atol=1e-6)
    assert tensors.z_exp.requires_grad, "training learns the table of codes"


@pytest.mark.parametrize("name", ["z_id", "z_exp", "shape", "expression"])
def test_too_many_components_are_named(model, person, name):
    controls = Controls(**{name: np.zeros(EXPRESSIONS + 1, np.float32)})
    with pytest.raises(ShapeError, match=name):
        model.input_space().inputs(person, controls)


def test_without_residuals_coefficients_are_the_codes(head, person):
    plain = GRMM(head, PRESETS["tiny"].replace(residuals=False))
    space = plain.input_space()
    found = space.inputs(person, Controls().set_named({"jawOpen": 0.5}))
    np.testing.assert_array_equal(found.z_id, found.shape)
    np.testing.assert_array_equal(found.z_exp, found.expression)
    assert not space.code_norms.any()


def test_keys_change_with_what_they_stand_for(model):
    frame = ModelInputs(*(np.zeros(n, np.float32) for n in (6, 5, SHAPES, EXPRESSIONS)), np.zeros((5, 3), np.float32))
    keys = ("identity_key", "code_key", "shape_key", "mesh_key")
    changes = {
        "z_id": {"identity_key", "code_key", "mesh_key"},
        "z_exp": {"code_key", "mesh_key"},
        "shape": {"shape_key", "mesh_key"},
        "expression": {"mesh_key"},
        "pose": {"mesh_key"},
        "strength": {"mesh_key"},
    }
    for name, expected in changes.items():
        other = dataclasses.replace(frame, **{name: getattr(frame, name) + np.float32(0.25)})
        assert {key for key in keys if getattr(other, key) != getattr(frame, key)} == expected, name


# --- batches ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # the first one is placed by the compiled kernel
def test_a_batch_is_its_frames(head, dtype):
    torch.manual_seed(1)
    model = GRMM(head, PRESETS["tiny"]).to(dtype)
    randomise(model)
    frames = [inputs(model, seed) for seed in range(6)]
    names = ("z_id", "z_exp", "shape", "expression", "pose")
    views = torch.nn.functional.normalize(torch.randn(2, 3, 3, generator=torch.Generator().manual_seed(4)).to(dtype), dim=-1)
    batch = ModelInputs(*(torch.stack([getattr(f, name) for f in frames]).unflatten(0, (2, 3)) for name in names), 0.7)
    with torch.no_grad():
        mesh, decoded = model.mesh(batch), model.attributes(batch, views)
        placed = model.geometry(mesh.vertices, decoded.offsets)
        normals = model.anchor(mesh.vertices).normals
        for number, frame in enumerate(frames):
            at = divmod(number, 3)
            frame = dataclasses.replace(frame, strength=0.7)
            one, attributes = model.mesh(frame), model.attributes(frame, views[at])
            alone = (*one, *vars(attributes).values(), *model.geometry(one.vertices, attributes.offsets))
            both = (*mesh, *vars(decoded).values(), *placed)
            for part, whole in zip(alone, both, strict=True):
                torch.testing.assert_close(whole[at], part, rtol=1e-4, atol=1e-5)
            torch.testing.assert_close(normals[at], model.anchor(one.vertices).normals, rtol=1e-4, atol=1e-5)


def test_missing_expression_components_are_zero(model):
    frame = inputs(model)
    short = dataclasses.replace(frame, expression=frame.expression[:7])
    full = dataclasses.replace(frame, expression=torch.nn.functional.pad(frame.expression[:7], (0, EXPRESSIONS - 7)))
    for one, other in zip(model.mesh(short), model.mesh(full), strict=True):
        torch.testing.assert_close(one, other)
    assert torch.equal(model.mesh(full, model.rest(full.shape)).vertices, model.mesh(full).vertices)


# --- pictures --------------------------------------------------------------------------------------------------------


def test_the_strength_scales_the_learned_displacement(model):
    frame = inputs(model)
    whole, half = (model.displacement(dataclasses.replace(frame, strength=s)) for s in (1.0, 0.5))
    torch.testing.assert_close(half, 0.5 * whole)


def test_gaussians_that_are_appended_are_drawn_with_the_head(model):
    """Hair and the like ride in the same call of the rasteriser; the refinement network sees no features of theirs."""
    from grmm_core.splat import Gaussians

    camera, frame = Camera.orbit(40, 40, distance=0.8), inputs(model)
    with torch.no_grad():
        alone = model.render(camera, frame)
        ball = Gaussians(
            torch.tensor([[0.0, 0.13, 0.0]]), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.01), torch.ones(1),
            torch.tensor([[0.0, 1.0, 0.0]]), torch.zeros(1, model.config.features),
        )  # fmt: skip
        both = model.draw(Gaussians.concatenate([alone.gaussians, ball]), camera)
    assert float(both.alpha.sum()) > float(alone.alpha.sum()) + 10.0
    new = (both.alpha > 0.9) & (alone.alpha < 0.01)
    assert new.any()
    assert float(both.raw[new][:, 1].min()) > 0.8


def test_portraits_show_the_resting_expression(model, person):
    resting = np.zeros(EXPRESSIONS, np.float32)
    resting[SMILE] = 1.0
    own = dataclasses.replace(person, expression=resting)
    camera = Camera.orbit(48, 48, distance=0.8)
    shown = portrait(model, own, {}, camera).image
    torch.testing.assert_close(shown, portrait(model, person, {f"expression.{SMILE}": 1.0}, camera).image)
    assert (shown - portrait(model, person, {}, camera).image).abs().max() > 0.02
    assert not shown.requires_grad


def test_a_thumbnail_is_the_portrait_with_straight_alpha(model, person):
    found = np.asarray(Image.open(io.BytesIO(thumbnail(model, person, 40))))
    picture = portrait(model, person, {}, portrait_camera(40))
    assert found.shape == (40, 40, 4)
    np.testing.assert_allclose(found[..., 3] / 255.0, picture.alpha.clamp(0, 1), atol=0.51 / 255)
    over = found[..., :3] / 255.0 * (found[..., 3:] / 255.0)
    solid = picture.alpha > 0.5
    np.testing.assert_allclose(
        over[solid], torch.minimum(picture.image, picture.alpha[..., None])[solid].clamp(0, 1), atol=2.0 / 255
    )


# --- levels of detail ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lod", [1, 2, 3])
def test_blocks_hold_their_texels(model, lod):
    texel, grid, side = model.anchor.texel.numpy(), model.anchor.grid, 1 << lod
    middle, block, counts = texel_blocks(texel, grid, lod)
    squares: dict[tuple[int, int], list[int]] = {}
    for number, place in enumerate(texel.tolist()):
        squares.setdefault((place // grid // side, place % grid // side), []).append(number)
    assert len(squares) == len(middle) == len(counts)
    for members in squares.values():
        assert len(set(block[members])) == 1
        own = block[members[0]]
        assert counts[own] == len(members)
        away = [abs(texel[n] // grid % side - side // 2) + abs(texel[n] % grid % side - side // 2) for n in members]
        assert middle[own] == members[int(np.argmin(away))]
