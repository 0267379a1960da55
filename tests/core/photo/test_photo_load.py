"""Photos as people have them, and files that are none; the person mask."""

from __future__ import annotations

import os

import numpy as np
import pytest
import torch
from fuzzing import memory_limit
from PIL import Image

from grmm_core.errors import FileAccessError, FileFormatError, GrmmError
from grmm_core.photo.load import load_photo
from grmm_core.photo.orientation import orientation_of, upright
from grmm_core.photo.person import box_sum, guided_filter, person_mask


@pytest.fixture
def gradient() -> np.ndarray:
    y, x = np.mgrid[0:96, 0:128]
    return np.stack([2 * x, 2 * y, 255 - x - y], axis=2).astype(np.uint8)


def test_eight_bit_rgb_is_read_exactly(tmp_path, gradient):
    Image.fromarray(gradient).save(tmp_path / "фото é.png")
    photo = load_photo(tmp_path / "фото é.png")
    np.testing.assert_allclose(photo.pixels, gradient / 255.0, atol=1e-6)
    assert photo.alpha is None
    assert photo.scale == 1.0


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_exif_orientation_is_undone(tmp_path, gradient, orientation):
    stored = {  # how a camera stores the upright picture for each value of the tag (EXIF 2.3, tag 0x0112)
        1: gradient, 2: gradient[:, ::-1], 3: gradient[::-1, ::-1], 4: gradient[::-1],
        5: gradient.transpose(1, 0, 2), 6: np.rot90(gradient, 1), 7: gradient[::-1, ::-1].transpose(1, 0, 2),
        8: np.rot90(gradient, -1),
    }[orientation]  # fmt: skip
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "turned.png"
    Image.fromarray(np.ascontiguousarray(stored)).save(path, exif=exif)
    np.testing.assert_allclose(load_photo(path).pixels, gradient / 255.0, atol=1e-6)
    assert orientation_of(path) == orientation
    np.testing.assert_array_equal(upright(stored, orientation), gradient)


@pytest.mark.parametrize("kind", ["jpeg", "webp", "tiff", "png"])
def test_the_orientation_of_files_that_others_write(tmp_path, gradient, kind):
    exif = Image.Exif()
    exif[0x010F], exif[0x0112] = "A camera", 6
    path = tmp_path / f"x.{kind}"
    Image.fromarray(gradient).save(path, exif=exif)
    assert orientation_of(path) == 6
    Image.fromarray(gradient).save(path)
    assert orientation_of(path) == 1
    whole = path.read_bytes()
    for end in range(0, min(len(whole), 400), 7):
        path.write_bytes(whole[:end])
        assert orientation_of(path) == 1
    assert orientation_of(tmp_path / "missing.jpg") == 1


@pytest.mark.parametrize("kind", ["grey", "16-bit", "palette", "1-bit", "cmyk"])
def test_other_kinds_of_pictures(tmp_path, gradient, kind):
    path = tmp_path / ("x.jpg" if kind == "cmyk" else "x.png")
    image = Image.fromarray(gradient)
    if kind == "16-bit":
        image = Image.fromarray(gradient[:, :, 0].astype(np.uint16) * 257)
    else:
        image = image.convert({"grey": "L", "palette": "P", "1-bit": "1", "cmyk": "CMYK"}[kind])
    image.save(path)
    pixels = load_photo(path).pixels
    assert pixels.shape == gradient.shape
    if kind == "16-bit":
        np.testing.assert_allclose(pixels[:, :, 1], gradient[:, :, 0] / 255.0, atol=1e-4)
    if kind == "grey":
        np.testing.assert_allclose(pixels[:, :, 0], np.asarray(image) / 255.0, atol=1e-6)


def test_alpha_is_kept_and_composited_over_grey(tmp_path, gradient):
    alpha = np.zeros((96, 128, 1), np.uint8)
    alpha[:, 64:] = 255
    Image.fromarray(np.concatenate([gradient, alpha], axis=2)).save(tmp_path / "x.png")
    photo = load_photo(tmp_path / "x.png")
    np.testing.assert_allclose(photo.pixels[:, :64], 0.5)
    np.testing.assert_allclose(photo.pixels[:, 64:], gradient[:, 64:] / 255.0, atol=1e-6)
    np.testing.assert_array_equal(photo.alpha, alpha[:, :, 0] / 255.0)


def test_a_fifty_megapixel_photo_is_reduced(tmp_path):
    Image.new("RGB", (8660, 5774), (200, 100, 50)).save(tmp_path / "large.jpg", quality=50)
    photo = load_photo(tmp_path / "large.jpg", max_side=1024)
    assert max(photo.pixels.shape) == 1024
    assert photo.scale == pytest.approx(1024 / 8660)
    np.testing.assert_allclose(photo.pixels.mean((0, 1)), np.array([200, 100, 50]) / 255.0, atol=0.02)


def test_files_that_are_no_photos_say_so(tmp_path):
    (tmp_path / "text.jpg").write_text("not a picture")
    with pytest.raises(FileFormatError, match="not a picture"):
        load_photo(tmp_path / "text.jpg")
    (tmp_path / "phone.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(64))
    with pytest.raises(FileFormatError, match="JPEG or PNG first"):
        load_photo(tmp_path / "phone.heic")
    Image.new("RGB", (40, 40)).save(tmp_path / "tiny.png")
    with pytest.raises(FileFormatError, match="40x40"):
        load_photo(tmp_path / "tiny.png")
    for missing in (tmp_path / "none.jpg", tmp_path):
        with pytest.raises(FileAccessError):
            load_photo(missing)


@pytest.mark.skipif(os.geteuid() == 0, reason="the administrator may read every file")
def test_a_photo_without_read_permission(tmp_path, gradient):
    path = tmp_path / "secret.png"
    Image.fromarray(gradient).save(path)
    path.chmod(0)
    with pytest.raises(FileAccessError, match="permission"):
        load_photo(path)


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tif", "gif"])
def test_damaged_photos_give_typed_errors_only(tmp_path, gradient, suffix):
    path = tmp_path / f"x.{suffix}"
    Image.fromarray(gradient).save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for trial in range(120):
        data = bytearray(whole[: rng.integers(1, len(whole))] if trial % 2 else whole)
        for position in rng.integers(0, len(data), 4):
            data[position] = rng.integers(256)
        path.write_bytes(data)
        try:
            assert np.isfinite(load_photo(path).pixels).all()
        except GrmmError:
            refused += 1
    assert refused > 20


@pytest.mark.parametrize("radius", [1, 4, 40])
def test_box_sums(radius):
    values = torch.rand(2, 1, 21, 17, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    size = 2 * radius + 1
    wanted = torch.nn.functional.conv2d(values, torch.ones(1, 1, size, size, dtype=torch.float64), padding=radius)
    torch.testing.assert_close(box_sum(values, radius), wanted)


def test_guided_filter_of_a_flat_guide_is_a_mean_and_keeps_edges_of_the_guide():
    value = torch.rand(1, 1, 20, 24, generator=torch.Generator().manual_seed(0))
    flat = guided_filter(torch.full_like(value, 0.5), value, 2, 1e-3)
    window = torch.nn.functional.avg_pool2d(value, 5, 1, 2, count_include_pad=False)
    expected = torch.nn.functional.avg_pool2d(window, 5, 1, 2, count_include_pad=False)
    torch.testing.assert_close(flat, expected, atol=1e-5, rtol=0)
    step = (torch.arange(24) >= 12).float().expand(1, 1, 20, 24)
    torch.testing.assert_close(guided_filter(step, step, 3, 1e-6), step, atol=1e-3, rtol=0)


def test_the_mask_covers_the_face_and_leaves_the_corners(photo_file):
    from grmm_core.photo.faces import find_faces

    photo = load_photo(photo_file("astronaut"))
    (face,) = find_faces(photo.pixels)
    mask = person_mask(photo.pixels, face.box)
    x, y = face.landmarks[:, :2].T.astype(int)
    assert np.quantile(mask[y, x], 0.05) > 0.95  # the outermost landmarks lie on the silhouette
    assert mask[y, x].mean() > 0.98
    assert mask[:60, :60].max() < 0.2
    assert mask[:60, -60:].max() < 0.2


def test_a_chunk_that_claims_gigabytes_takes_no_memory(tmp_path, gradient):
    path = tmp_path / "a.png"
    Image.fromarray(gradient).save(path)
    load_photo(path)
    data = bytearray(path.read_bytes())
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = (0x7FFFFFF0).to_bytes(4, "big")
    path.write_bytes(data)
    with memory_limit(1 << 29):  # all pixels are there; only what follows them is missing
        assert load_photo(path).pixels.shape == gradient.shape


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.jpg")
    with pytest.raises(FileAccessError, match="a device or a pipe"):
        load_photo(tmp_path / "a.jpg")
