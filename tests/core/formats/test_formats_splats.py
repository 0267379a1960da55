"""Splat files: round trips with stated errors, axes, and what each reader says about bad files."""

from __future__ import annotations

import gzip
import struct
import sys
import zlib
from dataclasses import replace

import numpy as np
import pytest
from fuzzing import memory_limit
from splat_files import make_cloud, ply_bytes, splat_rows

from grmm_core.errors import BackendError, FileAccessError, FileFormatError, ShapeError
from grmm_core.formats import SplatCloud, read_splats, write_splats
from grmm_core.formats.sequence import frame_path
from grmm_core.formats.splats.cloud import SH_C0

# Largest allowed error of a round trip: metres, 1 - |cos| of half the angle, logarithm of scale, opacity, color, harmonics.
TOLERANCES = {
    ".ply": (0.0, 2e-7, 1e-6, 1e-6, 1e-6, 1e-6),
    ".splat": (0.0, 1e-4, 0.0, 2e-3, 2.1e-3, None),
    ".spz": (2e-6, 3e-6, 0.0313, 2e-3, 3.8e-3, 0.0704),
    ".sog": (1e-5, 6e-5, 0.06, 2e-3, 6e-3, None),
    ".glb": (0.0, 2e-7, 0.0, 0.0, 1e-6, 1e-6),
}


def order_of(extension, cloud):
    """`.splat` files are sorted by how much a splat shows."""
    if extension != ".splat":
        return np.arange(cloud.count)
    return np.argsort(-cloud.scales.astype(np.float64).prod(1) * cloud.opacities, kind="stable")


def errors_between(a, b):
    terms = min(a.sh.shape[1], b.sh.shape[1])
    return (
        np.abs(a.means - b.means).max(),
        (1 - np.abs((a.quats * b.quats).sum(1))).max(),
        np.abs(np.log(a.scales / b.scales)).max(),
        np.abs(a.opacities - b.opacities).max(),
        np.abs(a.colors() - b.colors()).max(),
        np.abs(a.sh[:, 1:terms] - b.sh[:, 1:terms]).max() if terms > 1 else 0.0,
    )


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("extension", TOLERANCES)
def test_round_trip_within_the_stated_error(tmp_path, extension, degree):
    cloud = make_cloud(degree=degree)
    path = tmp_path / f"a{extension}"
    write_splats(path, cloud)
    back = read_splats(path)
    tolerances = TOLERANCES[extension]
    assert back.degree == (degree if tolerances[5] is not None else 0)
    for error, tolerance in zip(errors_between(back, cloud.select(order_of(extension, cloud))), tolerances, strict=True):
        assert error <= (tolerance or 0.0)
    assert back.warnings == []
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("version", [2, 3, 4])
def test_spz_versions(tmp_path, version):
    cloud = make_cloud(degree=2)
    write_splats(tmp_path / "a.spz", cloud, version=version, full_sh=True)
    errors = errors_between(read_splats(tmp_path / "a.spz"), cloud)
    assert errors[1] < (6e-3 if version == 2 else 3e-6)
    assert errors[5] <= 0.5 / 128 + 1e-6


def test_spz_of_a_large_scene_uses_fewer_fractional_bits(tmp_path):
    cloud = make_cloud()
    cloud.means = (cloud.means * 5000).astype(np.float32)
    write_splats(tmp_path / "a.spz", cloud)
    assert np.abs(read_splats(tmp_path / "a.spz").means - cloud.means).max() < 1e-3


def test_spz_4_without_zstandard_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(BackendError, match="zstandard"):
        write_splats(tmp_path / "a.spz", make_cloud(), version=4)
    (tmp_path / "b.spz").write_bytes(struct.pack("<IIIBBBBI12x", 0x5053474E, 4, 10, 0, 12, 0, 6, 32) + bytes(200))
    with pytest.raises(BackendError, match="version 3"):
        read_splats(tmp_path / "b.spz")


def test_files_of_viewers_with_y_down_are_turned_and_bound_splats_are_not(tmp_path):
    cloud = make_cloud()
    write_splats(tmp_path / "a.ply", cloud)
    raw = np.frombuffer((tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)[1], "<f4").reshape(cloud.count, -1)
    assert raw[:, :3] == pytest.approx(cloud.means * [1, -1, -1])
    assert (raw[:, 6:9] * SH_C0 + 0.5) == pytest.approx(cloud.colors(), abs=1e-6)
    write_splats(tmp_path / "b.ply", cloud, axes="y_up")
    raw = np.frombuffer((tmp_path / "b.ply").read_bytes().split(b"end_header\n", 1)[1], "<f4").reshape(cloud.count, -1)
    assert raw[:, :3] == pytest.approx(cloud.means)
    assert read_splats(tmp_path / "b.ply").means == pytest.approx(cloud.means), "the comment says so"
    bound = replace(cloud, binding=np.arange(cloud.count, dtype=np.int32))
    write_splats(tmp_path / "c.ply", bound)
    text, data = (tmp_path / "c.ply").read_bytes().split(b"end_header\n", 1)
    assert np.frombuffer(data, "<f4").reshape(cloud.count, -1)[:, :3] == pytest.approx(cloud.means)
    assert text.rstrip().endswith(b"property float binding_0")
    assert np.array_equal(read_splats(tmp_path / "c.ply").binding, bound.binding)


def harmonics_basis(directions):
    """The 16 real harmonics of 3DGS at unit directions, written out from their polynomials."""
    x, y, z = directions.T
    one = np.ones_like(x)
    return np.stack(
        [
            0.28209479177387814 * one, -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
            1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y),
            -0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y), 1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ],
        1,
    )  # fmt: skip


def test_turning_keeps_the_color_seen_from_every_side_and_the_ellipsoids():
    cloud = make_cloud(50, 3)
    turned = cloud.flipped()
    directions = np.random.default_rng(1).normal(size=(30, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = np.einsum("dk,nkc->ndc", harmonics_basis(directions), cloud.sh)
    after = np.einsum("dk,nkc->ndc", harmonics_basis(directions * [1, -1, -1]), turned.sh)
    assert after == pytest.approx(before, abs=1e-5)
    from grmm_core.geometry.rotations import quaternion_to_matrix

    def covariance(c):
        axes = quaternion_to_matrix(c.quats) * c.scales[:, None, :]
        return axes @ axes.transpose(0, 2, 1)

    flip = np.diag([1.0, -1.0, -1.0])
    assert covariance(turned) == pytest.approx(flip @ covariance(cloud) @ flip, abs=1e-9)
    assert errors_between(turned.flipped(), cloud) == pytest.approx((0,) * 6, abs=1e-6)


@pytest.mark.parametrize("kind", ["binary_little_endian", "binary_big_endian", "ascii"])
@pytest.mark.parametrize("double", [False, True])
def test_ply_in_other_orders_and_encodings(tmp_path, kind, double):
    rows = splat_rows(rest=9, double=double)
    (tmp_path / "a.ply").write_bytes(ply_bytes(rows, kind))
    cloud = read_splats(tmp_path / "a.ply", axes="y_up")
    assert cloud.means == pytest.approx(np.stack([rows[n] for n in "xyz"], 1), abs=1e-6)
    assert cloud.opacities == pytest.approx(1 / (1 + np.exp(-rows["opacity"])), abs=1e-6)
    # f_rest is channel-major: the second coefficient of the green channel stands at 3 + 1.
    assert cloud.sh[:, 2, 1] == pytest.approx(rows["f_rest_4"], abs=1e-6)
    assert np.linalg.norm(cloud.quats, axis=1) == pytest.approx(1)


def test_ply_with_triangles_before_and_after(tmp_path):
    rows = splat_rows(3)
    triangles = struct.pack("<Biii", 3, 0, 1, 2) * 2
    head = "element face 2\nproperty list uchar int vertex_indices\n"
    data = ply_bytes(rows, head=head)
    start = data.index(b"end_header\n") + 11
    (tmp_path / "a.ply").write_bytes(data[:start] + triangles + data[start:])
    assert read_splats(tmp_path / "a.ply").count == 3


def test_rows_that_are_not_finite_are_left_out_and_said(tmp_path):
    rows = splat_rows(20)
    rows["x"][3], rows["scale_0"][5], rows["rot_0"][7] = np.nan, 500.0, np.inf
    for i in range(4):
        rows[f"rot_{i}"][9] = 0
    (tmp_path / "a.ply").write_bytes(ply_bytes(rows))
    cloud = read_splats(tmp_path / "a.ply")
    assert cloud.count == 16
    assert cloud.warnings == ["4 of 20 splats had values that are not finite and were left out."]
    rows["y"] = np.nan
    (tmp_path / "a.ply").write_bytes(ply_bytes(rows))
    with pytest.raises(FileFormatError, match="none of its splats has finite values"):
        read_splats(tmp_path / "a.ply")


def ply_header(text):
    return b"ply\nformat binary_little_endian 1.0\n" + text + b"end_header\n"


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "does not start"),
        (b"ply\n", "no end"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex", "no end|line"),
        (ply_header(b"element vertex 99999999999999999999\n"), "has the line"),
        (ply_header(b"element vertex 9999999999999\nproperty float x\n"), "claims 9999999999999 rows"),
        (ply_header(b"element vertex 5\n"), "malformed"),
        (ply_header(b"element vertex -5\n"), "has the line"),
        (ply_header(b"property float x\n"), "has the line"),
        (ply_header(b"element vertex 1\nproperty float x\nproperty float x\n"), "malformed"),
        (ply_header(b"element vertex 1\nproperty list uchar float x\n") + b"\x05", "claims"),
        (ply_header(b"element vertex 1\nproperty list int float x\n") + b"\xff\xff\xff\x7f", "2147483647 entries"),
        (ply_bytes(splat_rows(drop=("opacity",))), "no column 'opacity'"),
        (ply_bytes(splat_rows(rest=7)), "fit no degree"),
        (ply_bytes(splat_rows())[:-1], "claims 20 rows"),
        (ply_bytes(splat_rows(), "ascii")[:-60], "a row|claims"),
        (ply_bytes(np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])), "point cloud or mesh"),
        (ply_bytes(np.zeros(4, [("packed_position", "<i4")])), "no chunks or no packed columns"),
    ],
)
def test_bad_ply_files(tmp_path, data, reason):
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_splats(tmp_path / "a.ply")
    assert "\n" not in str(caught.value)


def spz_bytes(version=3, count=10, degree=0, bits=12, body=None):
    rotation = 3 if version == 2 else 4
    body = bytes(count * (16 + rotation)) if body is None else body
    return gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, bits, 0, 0) + body, mtime=0)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "gzip|truncated"),
        (b"not gzip at all", "not compressed by gzip"),
        (gzip.compress(b"x", mtime=0), "truncated"),
        (gzip.compress(b"x" * 100, mtime=0), "no SPZ header"),
        (spz_bytes(version=9), "version is 9"),
        (spz_bytes(degree=7), "degree 7"),
        (spz_bytes(bits=99), "99 fractional bits"),
        (spz_bytes(count=0), "0 splats"),
        (spz_bytes(count=4_000_000_000, body=b"abc"), "4000000000 splats"),
        (spz_bytes(count=2_000_000, body=b"abc"), "more than it can hold"),
        (spz_bytes(count=100, body=bytes(200)), "more than it has"),
        (spz_bytes()[:-20], "more than it has|truncated"),
    ],
)
def test_bad_spz_files(tmp_path, data, reason):
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(FileFormatError, match=reason):
        read_splats(tmp_path / "a.spz")


def test_spz_bomb_is_not_unpacked_beyond_what_the_header_needs(tmp_path):
    import tracemalloc

    data = spz_bytes(count=10, body=bytes(60 << 20))
    (tmp_path / "a.spz").write_bytes(data)
    tracemalloc.start()
    cloud = read_splats(tmp_path / "a.spz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert cloud.count == 10
    assert peak < 20 << 20


@pytest.mark.skipif(sys.platform != "linux", reason="limits memory through /proc and setrlimit")
@pytest.mark.parametrize(("count", "degree", "refused"), [(10_000_000, 3, True), (10_000_000, 0, True), (7_000_000, 0, False)])
def test_a_small_spz_of_millions_of_splats_stays_within_a_gibibyte(tmp_path, count, degree, refused):
    stream = zlib.compressobj(1, zlib.DEFLATED, 31)
    data = stream.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, count, degree, 12, 0, 0))
    left = count * (20 + 3 * (0, 3, 8, 15)[degree])
    while left:
        size = min(left, 1 << 24)
        data += stream.compress(bytes(size))
        left -= size
    path = tmp_path / "a.spz"
    path.write_bytes(data + stream.flush())
    with memory_limit(1 << 30):
        if refused:
            with pytest.raises(FileFormatError, match=f"{count} splats would take"):
                read_splats(path)
        else:
            assert read_splats(path).count == count


def test_versions_of_spz_that_are_not_read_are_named(tmp_path):
    path = tmp_path / "a.spz"
    path.write_bytes(spz_bytes(version=1))
    with pytest.raises(FileFormatError, match="its version is 1, and in a file of this form 2 and 3 are read"):
        read_splats(path)
    path.write_bytes(gzip.decompress(spz_bytes(version=2)) + bytes(100))
    with pytest.raises(FileFormatError, match="its version is 2, and in a file of this form 4 is read"):
        read_splats(path)


def test_colors_that_a_format_clips_are_counted_and_said(tmp_path):
    cloud = make_cloud(20, 1)
    assert write_splats(tmp_path / "a.ply", cloud) == ()
    cloud.sh[:3, 0] = 3.0
    cloud.sh[3, 1] = 1.5
    assert write_splats(tmp_path / "a.ply", cloud) == ()
    assert write_splats(tmp_path / "a.splat", cloud)[0].startswith("3 of 20 splats have colors beyond")
    assert "no view dependence" in write_splats(tmp_path / "a.splat", cloud)[1]
    assert write_splats(tmp_path / "a.spz", cloud) == (
        "1 of 20 splats have view dependence beyond what SPZ holds; it was clipped.",
    )
    cloud.sh[:5, 0] = -4.0
    assert write_splats(tmp_path / "a.spz", cloud)[0].startswith("5 of 20 splats have colors beyond")
    assert write_splats(tmp_path / "a.glb", cloud) == ()


def test_splat_records_must_be_whole(tmp_path):
    for size in (0, 31, 33):
        (tmp_path / "a.splat").write_bytes(bytes(size))
        with pytest.raises(FileFormatError, match="32-byte records"):
            read_splats(tmp_path / "a.splat")


def test_unknown_extensions_missing_files_and_bad_clouds(tmp_path):
    cloud = make_cloud(5)
    with pytest.raises(FileFormatError, match=r"\.ply, \.splat, \.spz, \.sog, \.glb"):
        write_splats(tmp_path / "a.xyz", cloud)
    with pytest.raises(FileFormatError, match="not a splat file that can be read"):
        read_splats(tmp_path / "a.xyz")
    extensions = set(TOLERANCES)
    for extension in sorted(extensions):
        with pytest.raises(FileAccessError, match="does not exist"):
            read_splats(tmp_path / f"none{extension}")
        with pytest.raises(FileAccessError):
            write_splats(tmp_path / "no folder" / f"a{extension}", cloud)
        for name, value in (("means", np.nan), ("opacities", 1.5), ("scales", 0.0), ("quats", 0.0)):
            bad = replace(cloud, **{name: np.full_like(getattr(cloud, name), value)})
            with pytest.raises(ShapeError):
                write_splats(tmp_path / f"a{extension}", bad)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ShapeError, match="1, 4, 9 or 16"):
        replace(cloud, sh=np.zeros((5, 2, 3))).validated()
    with pytest.raises(ShapeError, match="binding"):
        replace(cloud, binding=np.full(5, -1)).validated()


def test_color_of_an_export_is_the_given_rgb():
    rgb = np.array([[0.1, 0.5, 0.9]])
    cloud = SplatCloud.from_rgb(np.zeros((1, 3)), np.array([[1, 0, 0, 0]]), np.full((1, 3), 1e-3), np.array([0.5]), rgb)
    assert cloud.sh[0, 0] == pytest.approx((rgb[0] - 0.5) / 0.28209479)
    assert cloud.colors() == pytest.approx(rgb)


def test_sequences_number_their_files():
    assert frame_path("a/head_####.ply", 12).name == "head_0012.ply"
    assert frame_path("a/head.ply", -3).name == "head_-0003.ply"


@pytest.mark.slow
@pytest.mark.parametrize("extension", TOLERANCES)
def test_a_million_splats(tmp_path, extension):
    write_splats(tmp_path / f"a{extension}", make_cloud(1_000_000, 1 if extension == ".spz" else 3))
    assert read_splats(tmp_path / f"a{extension}").count == 1_000_000
