"""SOG and glTF splat files: their containers, what their readers refuse."""

from __future__ import annotations

import io
import json
import struct
import sys
import zipfile

import numpy as np
import pytest
from fuzzing import glb_with
from PIL import Image
from splat_files import make_cloud

from grmm_core.errors import BackendError, FileFormatError, ShapeError
from grmm_core.formats import read_splats, write_splats
from grmm_core.formats.glb import GltfWriter
from grmm_core.formats.splats.webp import encode_webp


def sog_parts(tmp_path):
    write_splats(tmp_path / "a.sog", make_cloud())
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_sog_in_a_folder_and_in_a_zip_with_a_folder(tmp_path):
    parts = sog_parts(tmp_path)
    reference = read_splats(tmp_path / "a.sog")
    folder = tmp_path / "folder"
    folder.mkdir()
    for name, data in parts.items():
        (folder / name).write_bytes(data)
    assert np.array_equal(read_splats(folder / "meta.json").means, reference.means)
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as archive:
        for name, data in parts.items():
            archive.writestr(f"scene/{name}", data)
    assert np.array_equal(read_splats(tmp_path / "b.sog").means, reference.means)


def test_sog_names_that_leave_the_folder_are_refused(tmp_path):
    parts = sog_parts(tmp_path)
    secret = tmp_path / "secret.webp"
    secret.write_bytes(parts["quats.webp"])
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in ("../secret.webp", str(secret), "..\\secret.webp", ".."):
        meta = json.loads(parts["meta.json"])
        meta["means"]["files"][0] = name
        (folder / "meta.json").write_text(json.dumps(meta))
        with pytest.raises(FileFormatError, match="outside its folder"):
            read_splats(folder / "meta.json")


def test_sog_without_pillow_takes_a_decoder_or_says_what_to_install(tmp_path, monkeypatch):
    pictures = {
        data: np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))
        for name, data in sog_parts(tmp_path).items()
        if name.endswith(".webp")
    }
    reference = read_splats(tmp_path / "a.sog")
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(BackendError, match="Pillow"):
        read_splats(tmp_path / "a.sog")
    write_splats(tmp_path / "b.sog", reference)
    assert (tmp_path / "b.sog").stat().st_size > 1000
    decoded = read_splats(tmp_path / "a.sog", decode=pictures.__getitem__)
    assert np.array_equal(decoded.means, reference.means)
    with pytest.raises(FileFormatError, match="four channels"):
        read_splats(tmp_path / "a.sog", decode=lambda data: np.zeros((20, 20)))


def pictures_to_encode():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (37, 53, 4), dtype=np.uint8)
    normal = np.clip(rng.normal(128, 9, (120, 90, 4)), 0, 255).astype(np.uint8)
    normal[..., 3] = 255
    rare = [1, 1]  # counts for which Huffman's codes would be longer than the format allows
    while sum(rare) < 1_000_000:
        rare.append(rare[-1] + rare[-2])
    rare = np.concatenate([np.full(count, value, np.uint8) for value, count in enumerate(rare)])
    rare = np.stack([rare[: len(rare) // 1000 * 1000]] * 4, 1).reshape(-1, 1000, 4)
    clear = noise.copy()
    clear[..., 3] = rng.integers(0, 2, clear.shape[:2]) * 255
    flat = np.full((8, 3, 4), 7, np.uint8)
    return {"noise": noise, "normal": normal, "rare": rare, "clear": clear, "flat": flat, "pixel": noise[:1, :1]}


@pytest.mark.parametrize("name", ["noise", "normal", "rare", "clear", "flat", "pixel"])
def test_webp_pictures_come_back_from_the_reference_decoder(name):
    pixels = pictures_to_encode()[name]
    with Image.open(io.BytesIO(encode_webp(pixels))) as image:
        assert image.format == "WEBP"
        assert np.array_equal(np.asarray(image.convert("RGBA")), pixels)


@pytest.mark.parametrize("pixels", [np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4, 4)), np.zeros((1, 16385, 4), np.uint8)])
def test_pictures_that_webp_cannot_hold(pixels):
    with pytest.raises(ShapeError):
        encode_webp(pixels)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: m.update(version=1), "version 2"),
        (lambda m: m.update(count=10**9), "1 to 10000000"),
        (lambda m: m.update(count=500), "500 splats and"),
        (lambda m: m.update(count=True), "count is True"),
        (lambda m: m["scales"].update(codebook=[0.0] * 255), "256 numbers"),
        (lambda m: m["scales"].update(codebook=["a"] * 256), "256 numbers"),
        (lambda m: m["means"].update(mins=[0, 0, 10**400]), "3 numbers"),
        (lambda m: m["means"].update(files=[]), "names no file"),
        (lambda m: m["quats"].update(files=["sh0.webp"]), "largest component"),
        (lambda m: m.pop("sh0"), "no sh0"),
        (lambda m: m.update(shN={"bands": 9}), "bands is 9"),
        (lambda m: m.update(shN={"bands": 1, "count": 5, "codebook": [0] * 256, "files": ["sh0.webp", "sh0.webp"]}), "palette"),
        (lambda m: m["quats"].update(files=["meta.json"]), "damaged"),
    ],
)
def test_bad_sog_files(tmp_path, change, reason):
    parts = sog_parts(tmp_path)
    meta = json.loads(parts["meta.json"])
    change(meta)
    parts["meta.json"] = json.dumps(meta).encode()
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    with pytest.raises(FileFormatError, match=reason):
        read_splats(tmp_path / "b.sog")


def test_sog_with_higher_harmonics(tmp_path):
    parts = sog_parts(tmp_path)
    meta = json.loads(parts["meta.json"])
    rng = np.random.default_rng(3)
    codebook, entries = np.linspace(-1, 1, 256), 70
    palette = rng.integers(0, 256, (2, 64 * 3, 4)).astype(np.uint8)
    palette[..., 3] = 255
    labels = rng.integers(0, entries, 400)
    pixels = np.zeros((20, 20, 4), np.uint8)
    pixels[..., 0], pixels[..., 3] = (labels % 256).reshape(20, 20), 255

    def encode(array):
        buffer = io.BytesIO()
        Image.fromarray(array, "RGBA").save(buffer, "WEBP", lossless=True, exact=True)
        return buffer.getvalue()

    meta["shN"] = {"bands": 1, "count": entries, "codebook": codebook.tolist(), "files": ["c.webp", "l.webp"]}
    parts |= {"meta.json": json.dumps(meta).encode(), "c.webp": encode(palette), "l.webp": encode(pixels)}
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    cloud = read_splats(tmp_path / "b.sog", axes="y_up")
    assert cloud.degree == 1
    entry = labels[123]
    expected = codebook[palette[entry // 64, (entry % 64) * 3 + 2, :3]]
    assert cloud.sh[123, 3] == pytest.approx(expected)


def gltf(attributes, nodes=None, extensions=None, path=None, **change):
    """A splat glTF from arrays."""
    writer = GltfWriter()
    prefix = "KHR_gaussian_splatting:"
    named = {
        name if name == "POSITION" or name.startswith("_") else prefix + name: writer.add_array(array)
        for name, array in attributes.items()
    }
    primitive = {"mode": 0, "attributes": named, "extensions": extensions or {"KHR_gaussian_splatting": {"kernel": "ellipse"}}}
    writer.add("meshes", {"primitives": [primitive]})
    if nodes:
        writer.document["nodes"] = nodes
    writer.document |= change
    writer.write(path)
    return path


def splat_attributes(cloud):
    return {
        "POSITION": cloud.means,
        "ROTATION": cloud.quats[:, [1, 2, 3, 0]],
        "SCALE": cloud.scales,
        "OPACITY": cloud.opacities,
        "SH_DEGREE_0_COEF_0": cloud.sh[:, 0],
    }


def test_gltf_of_the_early_draft_has_logarithmic_scales(tmp_path):
    cloud = make_cloud(30)
    attributes = splat_attributes(cloud) | {"SCALE": np.log(cloud.scales)}
    back = read_splats(gltf(attributes, path=tmp_path / "a.glb"))
    assert back.scales == pytest.approx(cloud.scales, rel=1e-5)
    assert any("logarithms" in w for w in back.warnings)


def test_gltf_nodes_place_splats(tmp_path):
    cloud = make_cloud(30)
    half = 0.5**0.5
    nodes = [
        {"children": [1], "translation": [1, 2, 3], "scale": [2, 2, 2]},
        {"mesh": 0, "rotation": [0, half, 0, half]},
    ]
    back = read_splats(gltf(splat_attributes(cloud), nodes, path=tmp_path / "a.glb"))
    x, y, z = cloud.means.T
    assert back.means == pytest.approx(np.stack([2 * z + 1, 2 * y + 2, -2 * x + 3], 1), abs=1e-6)
    assert back.scales == pytest.approx(2 * cloud.scales)


@pytest.mark.parametrize(
    ("nodes", "reason"),
    [
        ([{"children": [0], "mesh": 0}], "no KHR"),
        ([{"children": [1]}, {"children": [2]}, {"children": [1], "mesh": 0}], "loop"),
        ([{"mesh": 7}], "does not have"),
        ([{"mesh": 0, "scale": [1, 2, 1]}], "differs between axes"),
        ([{"mesh": 0, "scale": [-1, 1, 1]}], "mirrored"),
        ([{"mesh": 0, "matrix": [1, 2]}], "malformed"),
        ([{"mesh": 0, "rotation": [0, 0, 0, 0]}], "malformed"),
        ([{"mesh": 0, "children": ["a"]}], "malformed"),
        ({"mesh": 0}, "malformed"),
    ],
)
def test_bad_gltf_nodes(tmp_path, nodes, reason):
    path = gltf(splat_attributes(make_cloud(5)), path=tmp_path / "a.glb", nodes=nodes)
    with pytest.raises(FileFormatError, match=reason):
        read_splats(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"accessors": [{"count": 10**9, "componentType": 5126, "type": "VEC3", "bufferView": 0}] * 5}, "more than 10000000"),
        ({"accessors": [{"count": 10**7, "componentType": 5126, "type": "VEC3", "bufferView": 0}] * 5}, "longer than its data"),
        ({"accessors": [{"count": 10**7, "componentType": 5126, "type": "VEC3"}] * 5}, "no data"),
        ({"accessors": [{"count": -1, "componentType": 5126, "type": "VEC3", "bufferView": 0}] * 5}, "count is -1"),
        ({"accessors": [{"count": 1, "componentType": 1, "type": "VEC3", "bufferView": 0}] * 5}, "unknown type"),
        ({"accessors": "x"}, "does not have"),
        ({"bufferViews": []}, "does not have"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 10**12}] * 5}, "longer than its data"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 900, "byteStride": 1}] * 5}, "longer than its data"),
    ],
)
def test_bad_gltf_accessors(tmp_path, change, reason):
    path = gltf(splat_attributes(make_cloud(20)), path=tmp_path / "a.glb", **change)
    with pytest.raises(FileFormatError, match=reason):
        read_splats(path)


def test_gltf_never_opens_other_files(tmp_path):
    cloud = make_cloud(5)
    path = gltf(splat_attributes(cloud), path=tmp_path / "a.glb")
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    (tmp_path / "secret.bin").write_bytes(data[28 + length :])
    document["buffers"][0]["uri"] = "secret.bin"
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match="another file"):
        read_splats(tmp_path / "a.gltf")


def test_gltf_with_linear_colors_looks_the_same(tmp_path):
    """`lin_rec709_display` of KHR_gaussian_splatting: colors from every side, brought to what a display is sent."""
    path, cloud = tmp_path / "a.glb", make_cloud(50, 1)
    cloud.sh[:, 1:] *= 0.02
    display = np.clip(cloud.colors(), 0.05, 0.95)
    linear = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
    slope = 2.4 / 1.055 * ((display + 0.055) / 1.055) ** 1.4
    written = make_cloud(50, 1)
    written.sh = (cloud.sh * slope[:, None]).astype(np.float32)
    written.sh[:, 0] = (linear - 0.5) / 0.28209479
    write_splats(path, written)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"srgb_rec709_display", b"lin_rec709_display "))
    assert read_splats(path).colors() == pytest.approx(written.colors(), abs=1e-5), "another value is not this one"
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    document["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["colorSpace"] = "lin_rec709_display"
    path.write_bytes(glb_with(data, document))
    found = read_splats(path)
    assert found.colors() == pytest.approx(display, abs=1e-5)
    assert found.sh[:, 1:] == pytest.approx(cloud.sh[:, 1:], abs=1e-5)
    assert any("colors are linear" in sentence for sentence in found.warnings)
