"""Avatar files: round trip, versions, damage, hostile headers; pictures and color."""

from __future__ import annotations

import io
import json
import struct
import zlib

import numpy as np
import pytest
from grmm_files import make_avatar
from PIL import Image
from safetensors import numpy as safetensors

from grmm_core.avatar import load_avatar, read_avatar_header, save_avatar
from grmm_core.avatar.deltas import rounded
from grmm_core.errors import FileAccessError, FileFormatError, GrmmError, ShapeError
from grmm_core.files.tensorfile import read_tensors, write_tensors
from grmm_core.model.config import PRESETS
from grmm_core.model.people import sampled_avatar
from grmm_core.model.weights_file import WeightsInfo
from grmm_core.pictures.color import linear_to_srgb, scene_linear_premultiplied, srgb_to_linear, straight_rgba
from grmm_core.pictures.images import encode_exr, encode_png, quantize


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "Ünï 人.grmm"
    save_avatar(make_avatar(), path)
    return path


def test_round_trip_keeps_everything(saved):
    original, loaded = make_avatar(), load_avatar(saved)
    for name in ("name", "head", "weights", "provenance", "thumbnail"):
        assert getattr(loaded, name) == getattr(original, name)
    for name in ("z_id", "z_exp", "shape", "expression", "pose"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(original, name))
    for name in ("tracking", "deltas"):
        stored, made = getattr(loaded, name), getattr(original, name)
        assert stored.keys() == made.keys()
        for key in made:
            np.testing.assert_array_equal(stored[key], made[key])
    np.testing.assert_array_equal(loaded.painting, original.painting)
    np.testing.assert_array_equal(loaded.camera.world_to_camera, original.camera.world_to_camera)
    assert (loaded.camera.fx, loaded.camera.width, loaded.camera.orthographic) == (original.camera.fx, 640, False)


def test_many_whole_numbers_take_a_byte_each(tmp_path):
    """As of the light that lies in folds; others are kept to the last bit."""
    random, path = np.random.default_rng(0), tmp_path / "small.grmm"
    whole = random.integers(-127, 128, (1, 2000, 3)).astype(np.float32)
    given = {"whole": whole, "few": whole[0, 0], "parts": whole + 0.5, "large": whole * 2.0, "empty": whole[:0]}
    save_avatar(make_avatar(tracking=given), path)
    for name, array in load_avatar(path).tracking.items():
        np.testing.assert_array_equal(array, given[name])
        assert array.dtype == np.float32
    stored = safetensors.load_file(path)
    assert {name for name in given if stored[f"tracking/{name}"].dtype == np.int8} == {"whole"}


def test_header_agrees_with_the_whole_file(saved):
    header, avatar = read_avatar_header(saved), load_avatar(saved)
    assert (header.name, header.weights, header.provenance) == (avatar.name, avatar.weights, avatar.provenance)
    assert header.thumbnail == avatar.thumbnail


def test_an_independent_library_reads_the_file(saved):
    tensors = safetensors.load_file(saved)
    np.testing.assert_array_equal(tensors["z_id"], make_avatar().z_id)


def test_arrays_cannot_be_changed_behind_the_avatar():
    source = np.zeros(8, np.float32)
    avatar = make_avatar(z_id=source)
    source[0] = 5.0
    assert avatar.z_id[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        avatar.z_id[0] = 1.0


@pytest.mark.parametrize("field", ["z_id", "z_exp", "shape", "expression", "pose"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(field, bad, saved):
    array = np.array(getattr(make_avatar(), field))
    array.flat[1] = bad
    with pytest.raises(ShapeError, match=f"{field}.*not a finite number"):
        make_avatar(**{field: array})
    tensors, metadata = read_tensors(saved)
    write_tensors(saved, tensors | {field: array}, metadata)
    with pytest.raises(FileFormatError, match=f"{field}.*not a finite number"):
        load_avatar(saved)


def edit(path, change):
    tensors, metadata = read_tensors(path)
    change(tensors, metadata)
    write_tensors(path, tensors, metadata)


def test_a_newer_version_says_what_to_do(saved):
    edit(saved, lambda tensors, metadata: metadata.update(format_version="7"))
    with pytest.raises(FileFormatError, match=r"format 7, newer than 4.*update GRMM"):
        load_avatar(saved)


def test_changes_of_maps_take_a_byte_a_number_and_come_back_as_they_were_rounded(tmp_path):
    g = np.random.default_rng(7)
    maps = {"decoders.appearance_mean": g.normal(0, 0.1, (3000, 16)) * np.geomspace(1e-7, 1, 3000)[:, None]}
    plain = {"decoders.few": g.normal(0, 1, (8, 3)), "decoders.row": g.normal(0, 1, 9000)}
    deltas = {name: rounded(array.astype(np.float32)) for name, array in (maps | plain).items()}
    assert np.abs(deltas["decoders.appearance_mean"] - maps["decoders.appearance_mean"]).max() < 0.5 / 255
    path = tmp_path / "changed.grmm"
    save_avatar(make_avatar(deltas=deltas), path)
    back = load_avatar(path)
    assert read_avatar_header(path).format_version == 3
    assert read_tensors(path)[0]["delta/decoders.appearance_mean"].dtype == np.int8
    for name, array in deltas.items():
        np.testing.assert_array_equal(back.deltas[name], array)
    edit(path, lambda tensors, metadata: tensors.update({"delta_scale/decoders.appearance_mean": np.ones((2, 2), np.float16)}))
    with pytest.raises(FileFormatError, match=r"scales of .* do not fit"):
        load_avatar(path)


def test_other_tensor_files_are_named_as_such(tmp_path):
    path = tmp_path / "weights.safetensors"
    write_tensors(path, {"a": np.zeros(3, np.float32)}, {"format": "pt"})
    with pytest.raises(FileFormatError, match=r"not a GRMM avatar; choose a \.grmm file"):
        load_avatar(path)
    with pytest.raises(FileAccessError, match="does not exist"):
        load_avatar(tmp_path / "missing.grmm")


@pytest.mark.parametrize(
    "change",
    [
        lambda t, m: t.pop("shape"),
        lambda t, m: t.update(shape=np.zeros(12, np.float32)),
        lambda t, m: t.update(pose=np.zeros((4, 3), np.float32)),
        lambda t, m: t.update(z_id=np.zeros((2, 2), np.float32)),
        lambda t, m: t.update(z_id=np.zeros(1 << 13, np.float32)),
        lambda t, m: t.update(painting=np.zeros((4, 3, 3), np.uint8)),
        lambda t, m: t.update(painting=np.zeros((4, 4, 3), np.float32)),
        lambda t, m: m.update(format_version="one"),
        lambda t, m: m.update(avatar="{"),
        lambda t, m: m.update(avatar="[]"),
        lambda t, m: m.update(avatar=json.dumps(json.loads(m["avatar"]) | {"thumbnail": "*"})),
        lambda t, m: m.update(avatar=json.dumps(json.loads(m["avatar"]) | {"name": 3})),
        lambda t, m: m.update(avatar=json.dumps(json.loads(m["avatar"]) | {"head": {"name": "x", "sha256": "../../etc"}})),
        lambda t, m: m.update(avatar=json.dumps(json.loads(m["avatar"]) | {"camera": {"fx": 1}})),
        lambda t, m: m.update(avatar="[" * 100_000),
    ],
)
def test_wrong_contents_give_one_sentence(saved, change):
    edit(saved, change)
    with pytest.raises(FileFormatError, match="not a readable avatar") as caught:
        load_avatar(saved)
    assert "\n" not in str(caught.value)


def test_flipped_and_cut_bytes_give_only_typed_errors(saved, tmp_path):
    """Two thousand damaged copies: each loads as a finite avatar or raises an error of ours."""
    data = saved.read_bytes()
    header_size = 8 + struct.unpack("<Q", data[:8])[0]
    rng = np.random.default_rng(3)
    path = tmp_path / "damaged.grmm"
    refused = 0
    messages = []
    for trial in range(2000):
        damaged = bytearray(data)
        if trial % 4 == 0:
            damaged = damaged[: rng.integers(0, len(data))]
        else:
            # mostly the header: that is where damage can confuse a reader
            end = header_size if trial % 4 < 3 else len(data)
            for position in rng.integers(0, end, size=rng.integers(1, 4)):
                damaged[position] = rng.integers(0, 256)
        path.write_bytes(damaged)
        try:
            avatar = load_avatar(path)
        except GrmmError as error:
            refused += 1
            messages.append(str(error).removeprefix(str(path)))
        else:
            assert np.isfinite(avatar.z_id).all()
            assert avatar.shape.shape == (300,)
    assert refused > 1000
    assert not [message for message in messages if "\n" in message or len(message) > 300]


def test_a_failed_write_leaves_the_old_file(saved, monkeypatch):
    before = saved.read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("grmm_core.files.access.os.fsync", full_disk)
    with pytest.raises(FileAccessError, match="no space left"):
        save_avatar(make_avatar(name="other"), saved)
    assert saved.read_bytes() == before
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_srgb_curves_are_inverse_and_hit_known_points():
    values = np.linspace(0.0, 1.2, 97, dtype=np.float32)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(values)), values, atol=2e-6)
    np.testing.assert_allclose(srgb_to_linear(np.array([0.5, 1.0])), [0.21404114, 1.0], atol=1e-6)


def test_premultiplied_conversions_agree_on_half_covered_pixels():
    color, alpha = np.full((1, 1, 3), 0.6, np.float32), np.full((1, 1, 1), 0.25, np.float32)
    linear = scene_linear_premultiplied(color * alpha, alpha)
    np.testing.assert_allclose(linear[0, 0], [*(srgb_to_linear(color[0, 0]) * 0.25), 0.25], rtol=1e-5)
    np.testing.assert_allclose(straight_rgba(color * alpha, alpha)[0, 0], [0.6, 0.6, 0.6, 0.25], rtol=1e-5)
    empty = straight_rgba(np.full((1, 1, 3), 0.3, np.float32), np.zeros((1, 1, 1), np.float32))
    np.testing.assert_array_equal(empty, 0.0)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_png_8_bit_is_read_back_exactly(channels):
    pixels = np.random.default_rng(0).integers(0, 256, (19, 23, channels), dtype=np.uint8)
    decoded = np.asarray(Image.open(io.BytesIO(encode_png(pixels))))
    np.testing.assert_array_equal(decoded.reshape(pixels.shape), pixels)


def test_png_16_bit_is_read_back_exactly():
    pixels = np.random.default_rng(0).integers(0, 1 << 16, (11, 7), dtype=np.uint16)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(encode_png(pixels)))), pixels)


def test_quantize_rounds_and_clips():
    np.testing.assert_array_equal(quantize(np.array([-1.0, 0.5 / 255.0, 0.4 / 255.0, 2.0])), [0, 1, 0, 255])


def test_exr_chunks_hold_the_values():
    rng = np.random.default_rng(1)
    picture = {"R": rng.normal(size=(37, 20)).astype(np.float32), "depth.Z": np.full((37, 20), 1e10, np.float32)}
    data = encode_exr(picture)
    # Undo the format's steps independently: offset table, deflate, differences, byte planes.
    table = data.index(b"screenWindowWidth") + len(b"screenWindowWidth\0float\0") + 8 + 1
    offsets = np.frombuffer(data[table : table + 24], "<u8")
    rows = []
    for offset in offsets.astype(int):
        _, size = struct.unpack("<ii", data[offset : offset + 8])
        packed = data[offset + 8 : offset + 8 + size]
        lines = min(16, 37 - 16 * len(rows))
        raw_size = lines * 2 * 20 * 4
        if size < raw_size:
            deltas = np.frombuffer(zlib.decompress(packed), np.uint8).astype(np.int64)
            deltas[1:] -= 128
            planes = (np.cumsum(deltas) % 256).astype(np.uint8)
            packed = np.stack([planes[: raw_size // 2], planes[raw_size // 2 :]], axis=1).tobytes()
        rows.append(np.frombuffer(packed, "<f4").reshape(lines, 2, 20))
    lines = np.concatenate(rows)
    np.testing.assert_array_equal(lines[:, 0], picture["R"])
    np.testing.assert_array_equal(lines[:, 1], picture["depth.Z"])


def test_drawn_people_are_near_one_kind_of_hair_and_shaped_like_everybody():
    rng = np.random.default_rng(0)
    kind = np.repeat([0, 1], 30)
    codes = rng.normal(size=(60, 8)) + 40.0 * kind[:, None]  # two kinds of hair, far apart
    shapes = rng.normal(size=(60, 4)) * [3.0, 1.0, 0.3, 0.1]
    weights = WeightsInfo("w", "h", "", PRESETS["tiny"], people=tuple(map(str, range(60))), z_id=codes, shapes=shapes)
    drawn = [sampled_avatar(weights, 5, seed, None) for seed in range(400)]
    along = np.array([avatar.z_id for avatar in drawn]).mean(1) / 40.0
    assert ((np.abs(along) < 0.35) | (np.abs(along - 1.0) < 0.35)).mean() > 0.98
    assert 0.3 < (along > 0.5).mean() < 0.7
    drawn_shapes = np.array([avatar.shape for avatar in drawn])
    np.testing.assert_allclose(drawn_shapes[:, :4].std(0), shapes.std(0), rtol=0.2)
    nearest = np.linalg.norm(drawn_shapes[:, None, :4] - shapes[None], axis=2).min(1)
    assert np.median(nearest) > 0.1  # new people
    again = sampled_avatar(weights, 5, 7, None)
    assert np.array_equal(again.z_id, drawn[7].z_id)
    assert np.array_equal(again.shape, drawn[7].shape)
