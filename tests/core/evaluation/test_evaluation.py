"""The evaluation: figures of known pictures, regions of the exact mesh, protocols on a model's own pictures."""

from __future__ import annotations

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from dask_workers import address, two_workers
from evaluation_data import HELD_OUT
from tiny_model import write_tiny_weights

from grmm_core.avatar import AssetReference, Avatar
from grmm_core.cli import main
from grmm_core.data.dataset import CaptureDataset
from grmm_core.errors import ConfigError, FileFormatError
from grmm_core.evaluation import protocols, report
from grmm_core.evaluation.disentanglement import smoothness, spread
from grmm_core.evaluation.haired import turned_degrees
from grmm_core.evaluation.lpips import SLICES, Lpips, load_lpips
from grmm_core.evaluation.metrics import errors_of
from grmm_core.evaluation.protocols import Evaluation, Settings
from grmm_core.evaluation.regions import REGIONS, region_pixels, triangle_groups
from grmm_core.evaluation.samples import Sample, limited, load, samples, source_view
from grmm_core.evaluation.scene import FULL, MEAN_CODES, NO_EXPRESSION_CODE, Scene
from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head


def evaluation(scene, folder, ablation=None, **settings):
    return Evaluation(scene, [CaptureDataset(folder)], Settings(**settings), ablation)


# --- one picture -----------------------------------------------------------------------------------------------------


def test_errors_of_known_pictures():
    truth = torch.full((20, 20, 3), 0.5)
    image, mask = truth.clone(), torch.zeros(20, 20)
    mask[:, :10] = 1.0
    image[:, :10] += 0.1
    pixels = np.zeros((20, 20), bool)
    pixels[:10, :10] = True
    tiny = np.zeros((20, 20), bool)
    tiny[0, 0] = True
    errors = errors_of(image, truth, mask, {"a": pixels, "b": tiny}, {"l1": lambda a, b: (a - b).abs().mean()})
    assert errors.psnr_mask == pytest.approx(20.0, abs=1e-3)
    assert errors.psnr == pytest.approx(20.0 + 10 * math.log10(2), abs=1e-3)
    assert errors.rmse_mask == pytest.approx(0.1, abs=1e-5)
    assert errors.perceptual["l1"] == pytest.approx(0.05, abs=1e-6)
    assert set(errors.regions) == {"a"}  # one pixel is not a region
    assert errors.regions["a"] == pytest.approx((100 * 3 * 0.01, 300), rel=1e-4)
    same = errors_of(truth, truth, mask)
    assert math.isinf(same.psnr)
    assert same.ssim_mask == pytest.approx(1.0)
    assert math.isnan(errors_of(truth, truth, torch.zeros(20, 20)).psnr_mask)


def test_regions_are_where_they_should_be():
    head = load_open_head()
    groups = triangle_groups(head)
    assert sum(len(rows) for rows in groups.values()) == len(head.faces)
    expression = np.zeros(head.expression_count, np.float32)

    def pixels(yaw, jaw=0.0, grow=0):
        expression[head.expression_index("jawOpen")] = jaw
        vertices = head.vertices(np.zeros(10), expression, head.pose_of(expression))
        camera = Camera.orbit(128, 128, yaw=yaw, distance=1.1, fov=20.0)
        from grmm_core.geometry.zbuffer import EMPTY, triangle_depth

        depth = triangle_depth(vertices[head.faces], camera)
        depth = np.where(depth < EMPTY, depth, 0.0)
        mask = (depth > 0).astype(np.float32)
        mask[:grow] = 1.0
        if grow:
            depth[mask.astype(bool) & (depth > 0)] -= 0.02  # something lies two centimetres before all of it
        return region_pixels(head, groups, vertices, camera, mask, depth)

    front, back, opened = pixels(0.0), pixels(180.0), pixels(0.0, jaw=1.0)
    assert all(front[name].sum() > 30 for name in ("eyes", "hair", "face", "neck"))
    assert back["face"].sum() + back["eyes"].sum() < 0.02 * front["face"].sum()
    assert back["hair"].sum() > front["hair"].sum()
    assert opened["mouth"].sum() > front["mouth"].sum() + 20
    assert sum(front[name].astype(int) for name in REGIONS).max() == 1
    rows = {name: np.argwhere(front[name]).mean(0)[0] for name in ("hair", "eyes", "neck")}
    assert rows["hair"] < rows["eyes"] < rows["neck"]
    covered = pixels(0.0, grow=128)
    assert covered["face"].sum() == 0
    assert covered["hair"].sum() > 0.9 * (128 * 128 - opened["mouth"].sum())


# --- the choice of views ---------------------------------------------------------------------------------------------


def fake(subject, number, yaw=0.0, fov=23.0, weight=0.0):
    camera = Camera.orbit(32, 32, yaw=yaw, distance=1.1, fov=fov)
    aligned = np.full(60, weight)
    shot = SimpleNamespace(subject=subject, number=number, aligned=aligned)
    return Sample(SimpleNamespace(folder="d"), shot, SimpleNamespace(camera=camera, name="c"))


def test_limited_views_are_spread_over_people_and_repeatable():
    candidates = [fake(name, n) for name in "abc" for n in range(8)]
    chosen = limited(candidates, 6)
    assert [s.shot.subject for s in chosen] == list("aabbcc")
    assert [s.shot.number for s in chosen] == [s.shot.number for s in limited(candidates, 6)]
    assert len({s.shot.number % 4 for s in limited(candidates, 12)}) > 1
    assert limited(candidates, 0) == candidates
    assert limited(candidates, 100) == candidates


def test_the_source_view_is_neutral_frontal_and_whole():
    best = fake("a", 3, yaw=12.0)
    others = [fake("a", 0, yaw=1.0, fov=11.0), fake("a", 1, yaw=2.0, weight=0.5), fake("a", 2, yaw=-170.0)]
    assert source_view([*others, best]) is best
    assert source_view(others) is others[1]
    with pytest.raises(ConfigError, match="no views"):
        source_view([])
    assert [fake("a", 0, yaw).direction for yaw in (-30, 90, 170)] == ["front", "side", "back"]
    assert fake("a", 0, 90.0).yaw == pytest.approx(90.0)
    assert others[0].close
    assert not best.close


# --- protocols -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", ["reconstruction", "novel-view", "expression"])
def test_a_model_reproduces_its_own_pictures(scene, folder, protocol):
    result = evaluation(scene, folder).run(protocol)
    assert [row.person.name for row in result.rows] == ["person 0", "person 1"]
    for row in result.rows:
        assert row.errors.psnr > 40.0  # eight bits a channel
        assert row.raw.psnr < row.errors.psnr  # the pictures are refined ones
        assert row.variants[MEAN_CODES].psnr_mask < row.errors.psnr_mask - 5.0
        if protocol != "reconstruction":  # those are neutral: their code is zero
            assert row.variants[NO_EXPRESSION_CODE].psnr_mask < row.errors.psnr_mask - 3.0


def test_a_fit_comes_closer_than_the_mean(scene, folder, monkeypatch):
    from grmm_core.evaluation import person_fit

    monkeypatch.setattr(person_fit, "STEPS", 30)
    runs = evaluation(scene, folder)
    result = runs.run("person")
    assert {row.sample.shot.number for row in result.rows} == {1, 2}
    assert result.source[HELD_OUT].shot.number == 0
    for row in result.rows:
        assert row.errors.psnr_mask > row.variants[MEAN_CODES].psnr_mask + 1.0
    photo = runs.run("monocular")
    assert [row.sample.shot.number for row in photo.rows] == [0]
    monkeypatch.setattr(protocols, "fit_person", None)  # the person is not fitted again
    assert len(runs.run("transfer").rows) == 2


def test_ablation_by_a_second_model(scene, folder, tmp_path):
    plain = Scene(write_tiny_weights(tmp_path / "plain.safetensors", residuals=False))
    assert plain.variants == (FULL,)
    distances = {"l1": lambda a, b: (a - b).abs().mean()}
    result = evaluation(scene, folder, plain, ablations=False, regions=False, distances=distances).run("reconstruction")
    values = report.summary(result)
    assert values["ablation"]["views"] == 2
    for name, better in (("psnr_mask", 1), ("ssim_mask", 1), ("l1", -1)):
        assert better * values["ablation"][name] < better * values["refined"][name]
    rows = [line.split("|")[1:-1] for line in report.table({"reconstruction": values}).splitlines() if "second model" in line]
    assert len(rows) == 1
    assert len(rows[0]) == 3 + 6
    assert all(float(cell) > 0 for cell in rows[0][2:])
    assert not result.rows[0].variants
    with pytest.raises(ConfigError, match="no residual codes"):
        plain.draw(plain.person(CaptureDataset(folder), "person 0"), result.rows[0].sample.shot, Camera.orbit(8, 8), MEAN_CODES)


def test_what_cannot_be_evaluated_is_explained(scene, folder, tmp_path):
    data = CaptureDataset(folder)
    sample = samples([data], "train")[0]
    assert load(sample, 24).image.shape == (24, 24, 3)
    with pytest.raises(ConfigError, match="no protocol"):
        evaluation(scene, folder).run("none")
    data.manifest.head = "flame2023"
    with pytest.raises(ConfigError, match="flame2023"):
        Evaluation(scene, [data], Settings())
    other = tmp_path / "other"
    other.mkdir()
    (other / "dataset.json").write_text((folder / "dataset.json").read_text())
    for protocol, word in (("reconstruction", "weights know"), ("person", "held-out people")):
        with pytest.raises(ConfigError, match=word):
            evaluation(scene, other).run(protocol)


def test_an_avatar_of_a_trained_person_is_judged_alone(weights, scene, folder):
    """Its own changes count, other people's views do not; strangers and avatars of other weights are refused."""
    info = scene.info
    colors = np.zeros((scene.model.gaussian_count, 3 + scene.model.config.features), np.float32)
    shape = np.zeros(300, np.float32)
    shape[: info.shapes.shape[1]] = info.shapes[1]
    same = Avatar(
        "Somebody", AssetReference(info.head_name, info.head_sha256), AssetReference(info.name, info.sha256), info.z_id[1],
        np.zeros(scene.model.z_exp_size, np.float32), shape, deltas={"decoders.appearance_mean": colors},
    )  # fmt: skip
    brighter = dataclasses.replace(same, deltas={"decoders.appearance_mean": colors + 0.05})
    found = []
    for avatar in (same, brighter):
        rows = evaluation(Scene(weights, avatar=avatar), folder, ablations=False, regions=False).run("expression").rows
        assert {row.sample.shot.subject for row in rows} == {"person 1"}
        found.append(rows[0].errors.psnr)
    assert found[0] > 40 > found[1]
    with pytest.raises(ConfigError, match="nobody whom"):
        Scene(weights, avatar=dataclasses.replace(same, z_id=same.z_id + 1))
    with pytest.raises(ConfigError, match="other weights"):
        Scene(weights, avatar=dataclasses.replace(same, weights=AssetReference("tiny", "f" * 64)))


def test_command(weights, folder, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["evaluate", str(weights), "--data", str(folder), "--perceptual", "none", "--protocol", "reconstruction"]
    assert main([*arguments, "expression", "-o", str(out), "--limit", "1", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    stored = json.loads((out / "evaluation.json").read_text())
    assert printed["protocols"]["reconstruction"]["views"] == 1
    assert stored["protocols"]["expression"]["rows"][0]["psnr"] > 40
    assert "| expression | 1 | 1 |" in (out / "evaluation.md").read_text()
    from PIL import Image

    assert Image.open(out / "reconstruction.png").size == (4 * 48 + 3 * 4, 48)
    broken = tmp_path / "broken"
    import shutil

    shutil.copytree(folder, broken)
    (broken / "shots" / "person 0" / "0000_00.png").write_bytes(b"none")
    (broken / "shots" / "person 1" / "0000_00.png").write_bytes(b"none")
    assert main(["evaluate", str(weights), "--data", str(broken), "--protocol", "reconstruction"]) == 1
    assert "0000_00.png is a damaged picture" in capsys.readouterr().err


def test_command_on_a_cluster(weights, folder, tmp_path, capsys):
    """Every protocol is a piece of work; figures and files are those of one process."""
    command = ["evaluate", str(weights), "--data", str(folder), "--protocol", "expression", "reconstruction"]
    figures, files = [], []
    with two_workers("import torch") as cluster:
        for name, options in (("here", ["--threads", "1"]), ("there", ["--cluster", address(cluster)])):
            assert main([*command, "--limit", "2", "-o", str(tmp_path / name), "--json", *options]) == 0
            figures.append(json.loads(capsys.readouterr().out))
            files.append(sorted(path.name for path in (tmp_path / name).iterdir()))
    here, there = figures
    assert files[0] == files[1]
    assert list(here["protocols"]) == list(there["protocols"]) == ["reconstruction", "expression"]
    for name, values in here["protocols"].items():
        assert there["protocols"][name]["refined"]["psnr_mask"] == pytest.approx(values["refined"]["psnr_mask"], abs=0.01)


def test_sheets_show_the_best_and_the_worst():
    def row(value, kept=True):
        return SimpleNamespace(errors=SimpleNamespace(psnr_mask=value), pictures=(1,) if kept else ())

    rows = [row(v) for v in (20.0, 31.0, math.nan, 25.0, 28.0)] + [row(99.0, kept=False)]
    assert [r.errors.psnr_mask for r in report.picked(rows[:2] + rows[3:], 2)] == [31.0, 20.0]
    assert math.isnan(report.picked(rows, 3)[-1].errors.psnr_mask)
    assert len(report.picked(rows, 9)) == 5


def test_tables_of_missing_numbers():
    assert report.codes_table({"people": 2, "expressions": 1, "x": {"difference_mm": 1, "size_mm": 2, "percent": 50.0}})
    page = report.sheet([[np.zeros((4, 6, 3)), np.ones((2, 2, 3))], [np.full((4, 6, 3), 0.5)]])
    assert page.shape == (4 * 2 + 4, 6 * 2 + 4, 3)
    assert (page[0, 0] == 0).all()
    assert (page[8, 0] == 128).all()


# --- codes -----------------------------------------------------------------------------------------------------------


def test_spread_and_smoothness_of_known_values():
    one = np.zeros((4, 3))
    one[:, 0] = 0.003
    other = one.copy()
    other[:, 1] = 0.004
    figures = spread([one, other])
    assert figures["difference_mm"] == pytest.approx(4.0)
    assert figures["size_mm"] == pytest.approx(4.0)  # 3 and 5
    even = [torch.full((2, 2, 3), v) for v in (0.0, 0.25, 0.5, 0.75, 1.0)]
    assert smoothness(even) == pytest.approx({"largest step": 1.0, "detour": 1.0})
    jump = [torch.full((2, 2, 3), v) for v in (0.0, 0.0, 1.0, 1.0, 1.0)]
    assert smoothness(jump)["largest step"] == pytest.approx(4.0)
    back = [torch.full((2, 2, 3), v) for v in (0.0, 1.0, 0.0, 1.0)]
    assert smoothness(back)["detour"] == pytest.approx(3.0)


@pytest.mark.slow
def test_codes_protocol(weights, tmp_path, capsys):
    assert main(["evaluate", str(weights), "--data", str(tmp_path), "--protocol", "codes", "-o", str(tmp_path)]) == 1
    assert "grmm:" in capsys.readouterr().err
    (tmp_path / "dataset.json").write_text(
        '{"format": "grmm-capture", "version": 1, "head": "open_head", "subjects": [], "settings": {}, "held_out_people": []}'
    )
    assert main(["evaluate", str(weights), "--data", str(tmp_path), "--protocol", "codes", "-o", str(tmp_path), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["codes"]
    assert figures["people"] == 4
    # the head model's own expression depends on the person by the place of the jaw joint only
    assert figures["same z_exp, other people: landmarks"]["size_mm"] > 1.0
    assert figures["z_id changed alone: gaussians"]["difference_mm"] > 0.0
    assert all((tmp_path / name).exists() for name in figures["pictures"])


# --- LPIPS -----------------------------------------------------------------------------------------------------------


def test_lpips_from_a_users_file(tmp_path):
    torch.manual_seed(0)
    state, width = {}, 3
    for number, layers in enumerate(SLICES):
        for index, channels in layers:
            state[f"net.slice{number + 1}.{index}.weight"] = torch.randn(channels, width, 3, 3) / (3 * width**0.5)
            state[f"net.slice{number + 1}.{index}.bias"] = torch.zeros(channels)
            width = channels
        state[f"lin{number}.model.1.weight"] = torch.rand(1, width, 1, 1)
    torch.save(state, tmp_path / "vgg.pth")
    network = load_lpips(tmp_path / "vgg.pth")
    a, noise = torch.rand(32, 32, 3), torch.rand(32, 32, 3)
    assert float(network(a, a)) == 0.0
    near, far = (float(network(a, a + t * (noise - a))) for t in (0.1, 0.8))
    assert 0.0 < near < far
    assert float(network(a, noise)) == pytest.approx(float(network(noise, a)), rel=1e-5)
    del state["lin4.model.1.weight"]
    with pytest.raises(FileFormatError, match="lin4"):
        Lpips(state)


def test_everybody_whom_the_weights_do_not_know_is_held_out(scene, folder, tmp_path):
    from evaluation_data import write_person

    from grmm_core.data.dataset import write_manifest
    from grmm_core.data.types import Manifest

    write_manifest(tmp_path, Manifest("open_head", ["s0009_0000", "person 2"], {}, []))
    for name in ("s0009_0000", "person 2"):
        write_person(tmp_path, scene, name, scene.info.z_id[2], scene.info.shapes[2], ("train",))
    runs = Evaluation(scene, [CaptureDataset(folder), CaptureDataset(tmp_path)], Settings())
    assert runs.held_out() == [(0, HELD_OUT), (1, "s0009_0000")]
    assert [s.shot.subject for s in runs._views_of(1, "s0009_0000", bare=False)] == ["s0009_0000"]


# --- fitting as users do ---------------------------------------------------------------------------------------------


def test_exact_tracks_are_what_the_capture_says(scene, folder):
    from grmm_core.evaluation.person_fit import exact_track, track_shot

    dataset = CaptureDataset(folder)
    sample = next(s for s in samples([dataset], "person") if s.shot.number == 1)
    view = load(sample)
    track = exact_track(scene.head, sample, view, dataset.shape(HELD_OUT))
    shot = track_shot(sample, track, scene.head)
    np.testing.assert_allclose(shot.pose, sample.shot.pose, atol=1e-6)  # the jaw that jawOpen turns is not counted twice
    assert track.arkit[24] == pytest.approx(0.6)
    inside = (track.landmarks > 0).all() and (track.landmarks < 48).all()
    assert inside
    np.testing.assert_allclose(track.image[0, 0], 0.5)  # nobody is in the corner


def test_exact_tracks_know_what_each_pixel_shows(scene, folder, monkeypatch):
    from grmm_core.data.layers import PARTS
    from grmm_core.evaluation.person_fit import exact_track
    from grmm_core.evaluation.samples import Sample
    from grmm_core.photo.parser import parse

    dataset = CaptureDataset(folder)
    sample = next(s for s in samples([dataset], "person"))
    view = load(sample)
    assert exact_track(scene.head, sample, view, dataset.shape(HELD_OUT)).labels is None  # the capture does not say
    masks = np.zeros((len(PARTS), *view.mask.shape), np.float32)
    masks[PARTS.index("skin")], masks[PARTS.index("teeth"), 20:24] = view.mask, 0.5
    monkeypatch.setattr(Sample, "parts", lambda self, size=0: masks)
    parts = parse(exact_track(scene.head, sample, view, dataset.shape(HELD_OUT)), scene.head)
    np.testing.assert_array_equal(parts.skin, view.mask)
    np.testing.assert_array_equal(parts.background, 1.0 - view.mask)
    np.testing.assert_array_equal(parts.mouth[20:24], 0.5)
    assert not parts.hair.any()


@pytest.mark.parametrize("found", [True, False])
def test_monocular_protocol_tracks_the_photo(scene, folder, monkeypatch, found):
    from dataclasses import replace

    from grmm_core.errors import NoFaceError
    from grmm_core.evaluation import person_fit
    from grmm_core.fitting import track as tracking

    runs = evaluation(scene, folder, method="fast", ablations=False)
    photo = source_view([s for s in samples([CaptureDataset(folder)], "person")])
    exact = person_fit.exact_track(scene.head, photo, load(photo), CaptureDataset(folder).shape(HELD_OUT))

    def track(paths, head, masks):
        if not found:
            raise NoFaceError("There is no face in photo.png; choose another photo.")
        assert paths[0].exists()
        assert masks[0].shape == (48, 48)
        return [replace(exact, source="photo.png")]

    def inverted(scene, track, name, method, report):
        code = scene.info.z_id.mean(0) + 0.7 * (scene.info.z_id[2] - scene.info.z_id[3])
        return scene.made(name, code, track.shape)

    monkeypatch.setattr(tracking, "track_photos", track)
    monkeypatch.setattr(person_fit, "_inverted", inverted)
    if not found:
        with pytest.raises(ConfigError, match="No face"):
            runs.run("monocular")
        return
    result = runs.run("monocular")
    assert len(result.rows) == 1
    assert result.rows[0].errors.psnr_mask > 25.0  # soft edges over grey instead of black


def test_people_are_fitted_by_the_inversion(scene, folder, monkeypatch):
    from grmm_core.fitting import presets
    from grmm_core.fitting.presets import CodeSettings, DecoderSettings, Preset

    quick = Preset("fast", CodeSettings(48, 48, 2, 1, 0, 4), DecoderSettings(((48, 4),), False))
    monkeypatch.setitem(presets.PRESETS, "fast", quick)
    shares = []
    runs = evaluation(scene, folder, method="fast", ablations=False, regions=False)
    result = runs.run("person", lambda share, message="": shares.append(share))
    assert len(result.rows) == 2
    person = result.rows[0].person
    assert person.name == HELD_OUT
    assert person.model is not scene.model  # the decoders were tuned for this person, and the scene's model was not
    assert person.photo_code is not None
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert all(np.isfinite(row.errors.psnr_mask) for row in result.rows)
    first = evaluation(scene, folder).run("reconstruction").rows[0]
    assert first.errors.psnr > 40.0


def test_weights_of_bare_heads_are_judged_by_bare_heads(folder):
    """Twins count where there are any, else what the source has; heads that are only bare are no truth for others."""
    from dataclasses import replace

    data = CaptureDataset(folder)
    first, *others = data.shots
    twins = tuple(replace(view, bare=replace(view, image="twin.png")) for view in first.views)
    alone = replace(others[0], views=tuple(replace(view, bare=view) for view in others[0].views))
    data.shots = [replace(first, views=twins), alone, *others[1:]]
    haired, bare = samples([data]), samples([data], bare=True)
    assert len(bare) == len(samples([CaptureDataset(folder)])) == len(haired) + len(alone.views)
    assert [sample.view.image for sample in bare[: len(twins)]] == ["twin.png"] * len(twins)
    assert not any(sample.shot is alone for sample in haired)


def test_people_wear_the_hair_that_their_capture_recorded(scene, folder, tmp_path):
    import shutil

    from grmm_core.hair.packaged import library_groom

    data = tmp_path / "capture"
    shutil.copytree(folder, data)
    bald = evaluation(scene, data, hair=True).run("reconstruction").rows
    for name in {row.sample.shot.subject for row in bald}:
        np.savez(data / "subjects" / f"{name}_groom.npz", **library_groom("crop").pack())
    haired = evaluation(scene, data, hair=True).run("reconstruction").rows
    assert [row.sample.name for row in haired] == [row.sample.name for row in bald]
    assert min(row.errors.psnr for row in bald) > 35.0  # as without a session
    assert max(row.errors.psnr for row in haired) < 30.0


def test_strands_are_turned_by_the_angle_between_them():
    y, x = np.mgrid[0:64, 0:64] / 64.0

    def stripes(degrees):
        angle = np.radians(degrees)
        return np.repeat(0.5 + 0.5 * np.sin(25.0 * (np.cos(angle) * x + np.sin(angle) * y))[..., None], 3, 2)

    everywhere = np.ones((64, 64))
    assert turned_degrees(stripes(20), stripes(20), everywhere) < 0.1
    assert turned_degrees(stripes(20), stripes(50), everywhere) == pytest.approx(30.0, abs=1.5)
    assert turned_degrees(stripes(10), stripes(170), everywhere) == pytest.approx(20.0, abs=1.5)  # a line has no sense
    assert math.isnan(turned_degrees(stripes(20), np.ones((64, 64, 3)), everywhere))
    grain = np.random.default_rng(0).normal(0, 0.3, (64, 64, 1))
    assert turned_degrees(stripes(20), stripes(50) + grain, everywhere) == pytest.approx(30.0, abs=3.0)
    assert math.isnan(turned_degrees(stripes(20), np.repeat(grain, 3, 2), everywhere))  # grain has no direction
