from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch
from model_fixtures import SHAPES, inputs, small_head

from grmm_core.errors import FileAccessError, FileFormatError, ShapeError
from grmm_core.files.packing import BLOCK, pack, unpack
from grmm_core.files.tensorfile import read_tensors, write_tensors
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM
from grmm_core.model.parameters import parameter_shapes
from grmm_core.model.weights import load_weights, save_weights
from grmm_core.model.weights_file import WeightsInfo, head_fingerprint, read_info


@pytest.fixture
def info(model):
    rng = np.random.default_rng(0)
    return WeightsInfo(
        "test", "", "", model.config, people=("Ada", "Zoë"), z_id=rng.random((2, 6)), shapes=rng.random((2, SHAPES)),
        default_z_id=rng.random(6), default_shape=rng.random(SHAPES), provenance={"seed": 3, "data": ["a"]},
    )  # fmt: skip


@pytest.fixture
def saved(tmp_path, model, info):
    path = tmp_path / "test.safetensors"
    save_weights(path, model, info)
    return path


def rewrite(path, change_tensors=lambda t: None, change_header=lambda h: None):
    tensors, metadata = read_tensors(path)
    header = json.loads(metadata["grmm"])
    change_tensors(tensors)
    change_header(header)
    write_tensors(path, tensors, {"grmm": json.dumps(header)})


def test_round_trip(saved, model, info, head):
    loaded, back = load_weights(saved, head)
    assert loaded.config == model.config
    for name, value in model.state_dict().items():
        packed = name.startswith("decoders.basis.")  # a 254th of the largest number in the neighbourhood
        error = 1.1 * float(value.abs().max()) / 254 if packed else 1e-6
        torch.testing.assert_close(loaded.state_dict()[name].float(), value.float(), rtol=1e-3, atol=error)
    assert back.people == ("Ada", "Zoë")
    assert back.provenance == {"seed": 3, "data": ["a"]}
    assert (back.head_name, back.head_sha256) == ("small_head", head_fingerprint(head))
    np.testing.assert_allclose(back.z_id, info.z_id, rtol=1e-6)
    np.testing.assert_allclose(back.default_shape, info.default_shape, rtol=1e-6)
    assert len(back.sha256) == 64
    assert read_info(saved).config == model.config
    assert all(p.requires_grad and p.device.type == "cpu" for p in loaded.parameters())
    assert not loaded.training


def test_loaded_model_draws_the_same(saved, model, head):
    loaded, _ = load_weights(saved, head)
    vertices = torch.from_numpy(head.v_template.copy())
    data, view = inputs(model), torch.tensor([0.0, 0.0, 1.0])
    one, two = (m.gaussians(vertices, m.attributes(data, view)) for m in (model, loaded))
    torch.testing.assert_close(one.means, two.means, atol=1e-4, rtol=0)
    torch.testing.assert_close(one.colors, two.colors, atol=3e-3, rtol=0)


@pytest.mark.parametrize("columns", [1, BLOCK, 3 * BLOCK + 7])
def test_packed_numbers_are_near_in_every_block(columns):
    rng = np.random.default_rng(columns)
    array = (rng.normal(size=(5, columns)) * 10.0 ** rng.integers(-5, 3, (5, columns))).astype(np.float32)
    array[0] = 0.0
    whole, scales = pack(array)
    back = unpack(whole, scales)
    assert (whole.dtype, scales.dtype, back.shape) == (np.int8, np.float16, array.shape)
    for start in range(0, columns, BLOCK):
        block = np.s_[:, start : start + BLOCK]
        largest = np.abs(array[block]).max(-1, keepdims=True)
        # half a step, and what rounding the scale to half precision takes from the largest
        assert (np.abs(back[block] - array[block]) <= largest * (0.5 / 127 + 2**-10) + 127 * 2**-24).all()


def test_basis_maps_are_stored_in_eight_bits_and_version_1_is_read(saved, model, head):
    tensors, _ = read_tensors(saved)
    names = [f"decoders.basis.{name}" for name in model.config.basis_channels]
    assert all(tensors[f"model/{name}"].dtype == np.int8 for name in names)

    def unpacked(tensors):
        for name in names:
            del tensors[f"model/{name}.scales"]
            tensors[f"model/{name}"] = model.state_dict()[name].numpy().astype(np.float16)

    rewrite(saved, unpacked, lambda header: header.update(version=1))
    loaded, _ = load_weights(saved, head)
    for name in names:
        torch.testing.assert_close(loaded.state_dict()[name], model.state_dict()[name], rtol=1e-3, atol=1e-6)


def test_another_head_is_refused(saved):
    with pytest.raises(FileFormatError, match="another version"):
        load_weights(saved, small_head(seed=1))


def test_weights_of_an_earlier_form_of_a_head_are_drawn_on_the_one_that_continues_it(saved, head):
    raised = head.v_template + np.float32([0, 0.002, 0])
    later = dataclasses.replace(head, v_template=raised, continues=(head_fingerprint(head),))
    loaded, info = load_weights(saved, later)
    assert loaded.head_model is later
    assert info.head_sha256 == head_fingerprint(later)  # what avatars made with them say
    said = (head_fingerprint(later), head_fingerprint(head), "", "f" * 64)  # in an avatar's file
    assert [info.stands_on(one) for one in said] == [True, True, True, False]
    assert info.people == ("Ada", "Zoë")
    assert len(info.z_id) == 2


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda h: h.update(version=99), "version"),
        (lambda h: h.update(format="pictures"), "not a GRMM weights file"),
        (lambda h: h.pop("head"), "incomplete"),
        (lambda h: h["config"].update(z_id="many"), "z_id"),
        (lambda h: h["config"].update(mesh_hidden=16000), "shape"),
        (lambda h: h["config"].update(smell=1), "smell"),
        (lambda h: h["people"].append("Eve"), "people/"),
    ],
)
def test_wrong_headers_are_explained(saved, head, change, word):
    rewrite(saved, change_header=change)
    with pytest.raises(FileFormatError, match=word):
        load_weights(saved, head)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda t: t.pop("model/aligned_codes"), "missing"),
        (lambda t: t["model/aligned_codes"].fill(np.nan), "not finite"),
        (lambda t: t.update({"model/aligned_codes": np.zeros((2, 2), np.float32)}), "shape"),
        (lambda t: t.update({"model/aligned_codes": np.zeros((60, 5), np.int32)}), "data type"),
        (lambda t: t.pop("model/decoders.basis.colour.scales"), "scales"),
        (lambda t: t.update({"model/decoders.basis.colour.scales": np.ones((1, 1), np.float16)}), "scales"),
        (lambda t: t["model/decoders.basis.colour.scales"].fill(np.inf), "not finite"),
        (lambda t: t["model/anchor.face"].fill(10**6), "layout"),
        (lambda t: t["model/anchor.texel"].fill(-1), "layout"),
        (lambda t: t["people/z_id"].fill(np.inf), "people/z_id"),
    ],
)
def test_damaged_tensors_are_explained(saved, head, change, word):
    rewrite(saved, change_tensors=change)
    with pytest.raises(FileFormatError, match=word):
        load_weights(saved, head)


def test_truncated_and_missing_files(saved, head, tmp_path):
    data = saved.read_bytes()
    for length in (0, 7, 100, len(data) - 10):
        saved.write_bytes(data[:length])
        with pytest.raises(FileFormatError):
            load_weights(saved, head)
    with pytest.raises(FileAccessError):
        load_weights(tmp_path / "none.safetensors", head)


def test_parameters_that_are_not_finite_are_not_written(tmp_path, model, info):
    path = tmp_path / "w.safetensors"
    save_weights(path, model, info)
    before = path.read_bytes()
    with torch.no_grad():
        model.aligned_codes[0, 0] = torch.nan
    with pytest.raises(ShapeError, match="aligned_codes"):
        save_weights(path, model, info)
    assert path.read_bytes() == before


@pytest.mark.parametrize("preset", sorted(PRESETS))
@pytest.mark.parametrize("change", [{}, {"residuals": False}, {"refine": False}, {"focus": True}])
def test_the_shapes_of_parameters_are_those_of_the_model(preset, change):
    head, config = small_head(), PRESETS[preset].replace(**change)
    with torch.device("meta"):
        model = GRMM(head, config)
    shapes = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    assert parameter_shapes(config, head, model.gaussian_count) == shapes
