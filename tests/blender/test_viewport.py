"""The splat viewport: drawing by the gpu module against the CPU rasteriser, its thread, level of detail, no graphics at all."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender

from grmm_core.geometry.camera import Camera
from grmm_core.splat.compensation import FINEST
from grmm_core.splat.rules import DILATION

pytestmark = pytest.mark.blender

# Mean absolute error of premultiplied display colors and cover between the graphics card's picture and the rasteriser's, and
# the largest error of all but a thousandth of the values. Half floats (which the software device rounds down), 12-bit colors
# and no early stop cause it: 0.0013 for thousands of random layers, 0.0004 for an avatar.
MEAN_ERROR = 2e-3
TAIL_ERROR = 0.03


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture(scope="module")
def drawn(run_blender: RunBlender, weights: Path, tmp_path_factory: pytest.TempPathFactory):
    """What `viewport_draw.py` reported, and the arrays that it stored."""
    folder = tmp_path_factory.mktemp("viewport")
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    result = run_blender("viewport_draw.py", weights, folder, python="5.2", environment=environment).result
    with np.load(folder / "viewport.npz") as archive:
        return result, dict(archive)


def _camera(stored: dict[str, np.ndarray], name: str) -> Camera:
    fx, fy, cx, cy, width, height, orthographic = stored[f"{name}_camera"].tolist()
    return Camera(stored[f"{name}_matrix"], fx, fy, cx, cy, int(width), int(height), bool(orthographic))


def _rasterized(
    stored: dict[str, np.ndarray], camera: Camera, placement: np.ndarray, prefix: str = "", antialiased: bool = False
) -> np.ndarray:
    import torch

    from grmm_core.splat import Gaussians, rasterize

    names = ("means", "quats", "scales", "opacities", "colors")
    gaussians = Gaussians(*(torch.from_numpy(stored[prefix + name]) for name in names))
    found = rasterize(gaussians, camera.transformed(placement), backend="cpu", antialiased=antialiased)
    return np.concatenate([found.rgb.numpy(), found.alpha.numpy()[..., None]], -1)


@pytest.mark.parametrize(
    ("kind", "antialiased"),
    [("perspective", False), ("perspective", True), ("orthographic", False), ("orthographic", True), ("avatar", False)],
)
def test_pictures_are_those_of_the_rasteriser(drawn, kind, antialiased):
    _, stored = drawn
    prefix = "avatar_" if kind == "avatar" else ""
    wanted = _rasterized(stored, _camera(stored, kind), stored[f"{prefix}placement"], prefix, antialiased)
    error = np.abs(stored[f"{kind}_antialiased" if antialiased else kind] - wanted)
    assert (wanted[..., 3] > 0.5).mean() > 0.1
    assert error.mean() < MEAN_ERROR
    assert np.quantile(error, 0.999) < TAIL_ERROR


def test_close_ups_have_no_gaps(drawn):
    found, _ = drawn
    plain, near, far, thinned = found["widths"]  # metres
    wide = DILATION**0.5 * FINEST
    assert plain < 0.7 * wide
    assert near >= 0.99 * wide
    assert far == thinned == plain
    assert found["paler"] < 0.01  # what is widened covers as much


def test_order_is_from_far_to_near(drawn):
    assert drawn[0]["sorted"]
    assert drawn[0]["permutation"]


def test_splats_hide_objects_and_are_hidden_by_them(drawn):
    found, _ = drawn
    assert found["covered"] > 0.1
    assert found["nothing_at_first"] == 0.0
    assert found["hidden_by_front"] == 0.0
    assert found["over_behind"] < 0.03  # cover of 0.98 lets two hundredths through
    assert found["beside_behind"] == 0.0
    assert found["hides_later"] == 0.0
    assert found["hidden_by_later"] == 0.0


def test_splats_stand_before_their_own_mesh(drawn):
    found, _ = drawn
    assert found["own_triangles"] > 1000
    assert found["own_mesh"] < 0.001
    assert found["ortho_covered"] > 0.1
    assert found["own_mesh_ortho"] < 0.001
    nearest, farthest = found["small_ortho"]  # the view's plane goes through the middle of the head
    assert -0.5 < nearest < -0.02
    assert 0.02 < farthest < 0.5
    assert found["bounds_meshes"] == 0
    assert found["sculpt"] == 0.0


def test_bones_are_seen_over_the_splats_while_the_rig_is_posed(drawn):
    found, _ = drawn
    looked_at, posed, overlays_off = found["bones"]
    assert (looked_at, overlays_off) == (0.0, 0.0)
    assert 0.005 < posed < 0.2
    assert found["bone_names"] == ["root", "neck", "jaw", "left_eye", "right_eye"]
    assert found["bone_colors"] == [4, 0]  # the eyes share one; selected bones have others


def test_only_what_changed_is_made_anew(drawn):
    found, _ = drawn
    assert found["nothing_changed"]
    assert found["pose_changed"] > 0.001


def test_lamps_light_a_head_that_takes_the_scenes_light(drawn):
    found, stored = drawn
    assert max(found["studio"]) < 1e-3
    right, left = (stored[f"lit_{side}"][..., :3].mean(-1) for side in ("right", "left"))
    half = right.shape[1] // 2
    assert right[:, half:].mean() > 1.5 * left[:, half:].mean()
    assert left[:, :half].mean() > 1.5 * right[:, :half].mean()
    np.testing.assert_allclose(stored["lit_right"][..., 3], stored["avatar"][..., 3], atol=1e-3)


def test_solid_view_lights_a_head_that_takes_the_scenes_light_by_its_studio_light(drawn):
    found, stored = drawn
    by_sun, by_studio_light, flat = found["solid"]
    assert by_sun == 0.0
    assert by_studio_light > 0.01
    assert flat < 1e-3
    right, left = (stored[f"solid_{side}"][..., :3].mean(-1) for side in ("right", "left"))
    half = right.shape[1] // 2
    assert right[:, half:].mean() > 1.5 * left[:, half:].mean()
    assert left[:, :half].mean() > 1.5 * right[:, :half].mean()


def test_splats_go_along_with_a_rig_that_is_dragged(drawn):
    found, _ = drawn
    old_ones, late, moved = found["dragged"]
    assert old_ones, found["dragged_shown"]
    assert moved > 0.01
    assert late < 0.1 * moved
    assert found["dragged_levels"] == [0, 2, 0]  # made when the rig rests; coarsely while the face changes, and at rest


def test_playback_falls_back_to_the_mesh_and_says_so(drawn):
    found, _ = drawn
    mesh_only = [0.0, ["Mesh only during playback"]]
    assert found["statuses"] == [["Loading splats; the first time after installing can take a minute"], []]
    assert found["mesh"] == mesh_only
    assert found["too_slow"] == mesh_only
    assert found["full"] > 0.9
    assert found["after"] == []


def test_playback_shows_a_small_picture_where_drawing_is_slow(drawn):
    found, stored = drawn
    cover, status, is_picture = found["small"]
    assert cover > 0.9
    assert status == ["Small picture during playback"]
    assert is_picture
    assert np.abs(stored["small"] - stored["level"]).mean() < 0.01


def test_small_pictures_are_of_where_heads_are(drawn):
    found, stored = drawn
    (left, lower, right, upper), cut = found["frames"]
    assert 0.0 < left < right < 1.0
    assert 0.0 < lower < upper < 1.0
    fine, coarse = stored["small_far"], stored["small_whole"]
    share = (right - left) * (upper - lower)
    assert fine.mean() * share == pytest.approx(coarse.mean(), rel=0.05)
    assert fine.size == pytest.approx(coarse.size, rel=0.02)
    assert cut == [0.0, 0.0, 1.0, 1.0]  # what reaches farther is not cut off


def test_playback_does_not_wait_for_compiling_nor_judge_by_it(drawn):
    found, _ = drawn
    assert found["first_small"] == [0.0, False, True]


def test_playback_without_a_graphics_card_begins_with_a_small_picture(drawn):
    found, _ = drawn
    assert found["software"] == ["Small picture during playback"]


def test_playback_waits_for_the_card_in_few_frames(drawn):
    found, _ = drawn
    assert 8 <= found["waits"] <= 24  # of 80 times that a frame could wait
    assert found["measured"] > 0


def test_frames_of_playback_show_their_own_splats(drawn):
    found, _ = drawn
    assert found["own"] == [True, True, True]
    assert found["played"] == 0


def test_errors_are_said_and_clouds_need_no_model(drawn):
    found, _ = drawn
    assert found["shot_names"] == ["Ball", "Sample 3"]
    assert "missing.grmm does not exist" in found["error"][0]
    assert found["cloud"][0] > 0.9
    assert found["cloud"][3] > 0.95
    assert found["panel"]


def test_without_graphics_nothing_fails(run_blender: RunBlender, weights: Path, blender_version):
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    found = run_blender("viewport_plain.py", weights, python=blender_version, environment=environment).result
    assert found["callbacks"] == 0
    # 0.9 s with 0.04 s to spare: a small picture at most; where Blender takes a second, up to a fourth of that is spent.
    assert found["ways"] == [0, 4, None, None, None, None, 0, 2, 3, 4, 4, 4]
    assert found["again"] == 2
    assert found["levels"] == [0, 1, 2, None, 0]
    assert found["doubted"] == [1, 0]
    assert found["first_measure"] == 0
    assert found["begun"] == [False, True]
    assert found["made"] == [["a", 2, 1.0], ["a", 0, 1.0]]
    assert found["played"] == [["a", 2, 1.0]]  # nothing better is made of a frame of playback
    assert found["other_hair"] == [True, False]  # a hairstyle alone is a reason to draw
    assert found["camera_moved"] == []
    assert found["turned"] == [["a", 2, 1.0], ["a", 0, 1.0]]
    assert found["neared"] == [[], [["a", 0, 1.0]], []]
    assert found["error"] == ["a: The model worker ended."]
    assert found["defect"] == ["Splats cannot be shown (ZeroDivisionError: oops)."]
    assert found["thinned"] <= 100
    assert found["finite"] == 2
    assert found["rendered"]
    assert found["bones"] == [0, 5]
