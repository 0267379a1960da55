"""`grmm export`: splats, meshes, arrays, recordings, avatars of other programs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from grmm_core.formats import formats, read_splats, suffixes

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def export(grmm, weights):
    def call(*arguments: object) -> tuple[int, str, str]:
        return grmm("export", "default", *arguments, "--weights", weights, "--device", "cpu")

    return call


@pytest.mark.parametrize("suffix", suffixes(formats("splats", written=True), shared=False))
def test_exported_splats_are_read_back(grmm, export, tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    code, out, _ = export("-o", path, "--set", "jawOpen=0.5", "--json")
    assert code == 0
    cloud = read_splats(path)
    assert cloud.count == json.loads(out)["gaussians"]
    assert cloud.means[:, 1].max() > 0.1  # the top of the head is up again
    assert 0.1 < cloud.colors().mean() < 0.9
    assert cloud.opacities.min() > 0.003  # what is never drawn is not written
    facts = json.loads(grmm("info", path, "--json")[1])
    assert facts["splats"] == cloud.count
    assert facts["size in metres"][1] > 0.2


def test_formats_options_are_flags(export, tmp_path):
    import gzip

    assert export("-o", tmp_path / "x.spz", "--spz-version", "2")[0] == 0
    assert int.from_bytes(gzip.decompress((tmp_path / "x.spz").read_bytes())[4:8], "little") == 2
    code, out, _ = export("-o", tmp_path / "x.splat", "--json")
    assert code == 0
    assert any("no view dependence" in sentence for sentence in json.loads(out)["warnings"])


def test_exported_meshes_follow_the_controls(export, tmp_path):
    heights = {}
    for name, setting in (("closed", "jawOpen=0"), ("open", "jawOpen=1")):
        path = tmp_path / f"{name}.obj"
        assert export("-o", path, "--set", setting)[0] == 0
        rows = [line.split()[1:4] for line in path.read_text().splitlines() if line.startswith("v ")]
        heights[name] = np.array(rows, float)
    assert 0.01 < np.abs(heights["open"] - heights["closed"]).max() < 0.1
    code, out, _ = export("-o", tmp_path / "x.glb", "--mesh", "--json")
    assert code == 0
    assert json.loads(out)["morphs"] == 52


def test_exported_arrays_are_complete(grmm, export, tmp_path):
    assert export("-o", tmp_path / "x.npz", "--sh-degree", "2")[0] == 0
    arrays = np.load(tmp_path / "x.npz")
    assert arrays["sh"].shape == (len(arrays["means"]), 9, 3)
    assert arrays["vertices"].shape == arrays["displacement"].shape
    assert arrays["faces"].max() == len(arrays["vertices"]) - 1
    code, out, _ = grmm("info", tmp_path / "x.npz", "--json")
    facts = json.loads(out)
    assert (code, facts["kind"], facts["arrays"]["vertices"]) == (0, "arrays", f"float32 {list(arrays['vertices'].shape)}")
    code, _, err = export("-o", tmp_path / "x.fbx")
    assert code == 1
    assert "cannot be written as '.fbx'" in err


def test_harmonics_reproduce_the_colors_seen(weights):
    """Degree 3 follows the decoder's view dependence closer than the mean color, from where Gaussians are seen."""
    from grmm_core.controls.frame import Controls
    from grmm_core.session import create_session
    from grmm_core.session.harmonics import fit_harmonics, harmonic_basis

    with create_session("local", weights=weights, device="cpu", threads=1) as session:
        info = session.open("default")
        view = np.array([0.6, 0.0, 0.8])
        cloud = session.gaussians(info.id, Controls(), view)
        seen = (cloud.means - cloud.means.mean(0)) @ view > 0.03
        errors = []
        for degree in (0, 1, 3):
            coefficients = fit_harmonics(session, info.id, Controls(), degree)
            fitted = 0.5 + np.einsum("c,ncx->nx", harmonic_basis(-view[None], degree)[0], coefficients)
            errors.append(np.abs(fitted - cloud.colors)[seen].mean())
    assert errors[2] < 0.5 * errors[0]
    assert errors[1] < errors[0]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Three frames of a Live Link Face file, 60 a second: a jaw that opens and a head that turns."""
    from grmm_core.controls.names import ARKIT_NAMES
    from grmm_core.formats import write_performance
    from grmm_core.performance import Performance

    weights = np.zeros((3, 52), np.float32)
    weights[:, ARKIT_NAMES.index("jawOpen")] = (0.0, 0.4, 0.8)
    path = tmp_path_factory.mktemp("recording") / "take.csv"
    turned = np.array([[0, 0, 0], [0.1, 0.2, 0.3], [0.2, 0.4, 0.5]])
    write_performance(path, Performance(np.arange(3) / 60, weights, 60.0, recorded_shapes=ARKIT_NAMES, head_rotation=turned))
    return path


@pytest.mark.parametrize(("name", "options"), [("h_##.ply", ()), ("h.obj", ("--set", "mouthSmileLeft=0.5"))])
def test_a_recording_becomes_a_file_for_each_frame(export, recording, tmp_path, name, options):
    code, out, err = export("-o", tmp_path / name, "--performance", recording, "--lod", "2", "--json", *options)
    assert code == 0, err
    facts = json.loads(out)
    assert facts["frames"] == 3
    files = sorted(tmp_path.iterdir())
    assert list(map(str, files)) == facts["files"]
    stem, suffix = ("h_0", ".ply") if "#" in name else ("h_000", ".obj")
    assert [file.name for file in files] == [f"{stem}{frame}{suffix}" for frame in range(3)]
    assert len({file.read_bytes() for file in files}) == 3
    code, out, _ = export("-o", tmp_path / name, "--performance", recording, "--lod", "2", "--json", "--fps", "120", *options)
    assert json.loads(out)["frames"] == 5


def test_a_recording_alone_takes_no_options_of_a_head(export, recording, tmp_path):
    for options in (("--set", "jawOpen=1"), ("--hair", "long")):
        code, _, err = export("-o", tmp_path / "x.json", "--performance", recording, *options)
        assert code == 1
        assert "holds the movement alone" in err
    assert list(tmp_path.iterdir()) == []


def test_recordings_are_converted_and_each_axis_of_the_head_can_be_flipped(grmm, recording, tmp_path):
    from grmm_core.formats import read_performance
    from grmm_core.formats.performances.turns import from_euler

    plain = from_euler(read_performance(recording).head_rotation)
    for axis, name in enumerate(("pitch", "yaw", "roll")):
        code, _, err = grmm("export", "default", "-o", tmp_path / "x.json", "--performance", recording, f"--flip-{name}")
        assert code == 0, err
        found = read_performance(tmp_path / "x.json")
        signs = np.where(np.arange(3) == axis, -1.0, 1.0)
        assert from_euler(found.head_rotation) == pytest.approx(plain * signs, abs=1e-5)
        assert found.weights == pytest.approx(read_performance(recording).weights, abs=1e-5)
    assert grmm("export", "default", "-o", tmp_path / "y.json", "--performance", recording, "--landscape")[0] == 0
    assert from_euler(read_performance(tmp_path / "y.json").head_rotation) == pytest.approx(plain * [-1, -1, 1], abs=1e-5)
    facts = json.loads(grmm("info", recording, "--flip-yaw", "--json")[1])
    assert facts["frames"] == 3
    assert json.loads(grmm("info", "default", "--json")[1])["kind"] == "grmm-avatar"


def test_a_gaussian_avatars_folder_from_the_command_line(grmm, export, recording, tmp_path):
    from flame_files import write_flame_pickle
    from flame_head_files import flame_head_fields

    from grmm_core.formats.avatars.gaussian_avatars import read_gaussian_avatar

    code, _, err = export("-o", tmp_path / "folder", "--performance", recording)
    assert code == 1
    assert "--flame" in err
    assert not (tmp_path / "folder").exists()
    write_flame_pickle(tmp_path / "flame.pkl", flame_head_fields())
    options = ("--flame", tmp_path / "flame.pkl", "--lod", "1", "--sh-degree", "0", "--json")
    code, out, err = export("-o", tmp_path / "folder", "--performance", recording, *options)
    assert code == 0, err
    found = read_gaussian_avatar(tmp_path / "folder")
    assert (found.track.frame_count, found.cloud.count) == (3, json.loads(out)["gaussians"])
    assert np.ptp(found.track.jaw_rotation[:, 0]) > 0.05
    assert found.track.head_rotation[2] == pytest.approx([0.2, 0.4, 0.5], abs=1e-4)
    assert export("-o", tmp_path / "still", "--set", "jawOpen=0.8", *options)[0] == 0
    still = read_gaussian_avatar(tmp_path / "still").track
    assert still.frame_count == 1
    assert still.jaw_rotation[0] == pytest.approx(found.track.jaw_rotation[2], abs=1e-4)
    track = tmp_path / "track.npz"
    assert grmm("export", "default", "-o", track, "--performance", recording, "--flame", tmp_path / "flame.pkl")[0] == 0
    assert json.loads(grmm("info", track, "--json")[1])["expression coefficients"] == 100
    code, _, err = grmm("export", "default", "-o", tmp_path / "x.json", "--performance", track)
    assert code == 1
    assert "has FLAME's coefficients and needs your own FLAME file" in err


def test_a_lam_avatar_from_the_command_line(grmm, export, recording, tmp_path):
    code, out, err = export("-o", tmp_path / "a.zip", "--lod", "2", "--json")
    assert code == 0, err
    facts = json.loads(grmm("info", tmp_path / "a.zip", "--json")[1])
    assert facts["splats"] == json.loads(out)["gaussians"]
    assert len(facts["morph targets"]) == 52
    code, _, err = export("-o", tmp_path / "b.zip", "--performance", recording)
    assert code == 1
    assert "hold no performance" in err
    code, _, err = export("-o", tmp_path / "b.csv")
    assert code == 1
    assert "name one with --performance" in err


def test_every_format_that_blender_writes_is_written_here(grmm):
    """Alembic and USD are Blender's own exporters; everything else has a name that `grmm export` takes."""
    from grmm_core.formats import format_to_write

    kinds = ("splats", "mesh", "avatar", "arrays", "performance")
    written = formats(kinds, written=True)
    for one in written:
        name = Path("folder" if one.folder else f"a{one.suffix}")
        assert format_to_write(name, one.holds) is one
    text = grmm("export", "--help")[1]
    assert all(one.suffix in text for one in written)
