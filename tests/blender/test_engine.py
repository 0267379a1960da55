"""The render engine, through F12 of the installed extension: cameras, passes, film, occlusion, errors, animations.

Blender 4.5 runs the model in its own process, Blender 5.2 (which has no torch) in a worker with the tests' interpreter.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender, find_python
from exr import layers_of, read_exr
from PIL import Image
from tolerances import CHANNEL_STEP

pytestmark = pytest.mark.blender

ENVIRONMENT = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1", "GRMM_TEST_THREADS": "1"}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture
def render_script(run_blender: RunBlender, weights: Path, tmp_path: Path):
    """Run a script of `tests/blender/scripts/` as SCRIPT WEIGHTS FOLDER ... and return what it reported."""

    def run(script: str, *arguments: object, python: str = "4.5", threads: int = 1, **options):
        environment = ENVIRONMENT | {"GRMM_TEST_THREADS": str(threads)}
        return run_blender(script, weights, tmp_path, *arguments, python=python, environment=environment, **options).result

    return run


def test_cameras(render_script, blender_version):
    result = render_script("engine_cameras.py", python=blender_version)["cameras"]
    assert len(result) == 9
    assert result["percentage"]["size"] == [72, 60]
    for name, values in result.items():
        assert values["projection"] < 0.01, name
        assert values["picture"] <= CHANNEL_STEP, name
        assert values["covered"] > 0.05, name


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def passes_of(request, run_blender: RunBlender, weights: Path, tmp_path_factory: pytest.TempPathFactory):
    """What `engine_passes.py` reported, the passes of one of its files, and what the session says they hold."""
    find_python(request.param)
    folder = tmp_path_factory.mktemp("passes")
    result = run_blender("engine_passes.py", weights, folder, python=request.param, environment=ENVIRONMENT).result
    with np.load(folder / "expected.npz") as archive:
        wanted = dict(archive)
    return lambda name: (result, layers_of(read_exr(folder / f"{name}.exr"), result["layer"]), wanted)


def test_passes(passes_of):
    result, passes, wanted = passes_of("passes")
    first, second = result["heads"]
    assert {"Combined", "Normal", "Mask", f"Mask {first}", f"Mask {second}", "Raw", "Features 00", "Features 07"} <= set(passes)
    depth = passes["Z"] if "Z" in passes else passes["Depth"]
    np.testing.assert_allclose(passes["Combined"], wanted["combined"], atol=2e-5)
    np.testing.assert_allclose(depth, wanted["depth"], rtol=1e-5)
    np.testing.assert_allclose(passes["Normal"], wanted["normal"], atol=1e-5)
    np.testing.assert_allclose(passes["Mask"], wanted["alpha"], atol=1e-5)
    np.testing.assert_allclose(passes[f"Mask {first}"], wanted["mask"][..., :1], atol=1e-5)
    np.testing.assert_allclose(passes[f"Mask {second}"], wanted["mask"][..., 1:], atol=1e-5)
    np.testing.assert_allclose(passes["Diffuse"], wanted["diffuse"], atol=2e-5)
    np.testing.assert_allclose(passes["Shadow"], wanted["shadow"], atol=1e-5)
    assert not passes["Specular"].any()  # in the studio's light all of a picture is diffuse
    np.testing.assert_allclose(passes["Features 00"], wanted["features"][..., :4], atol=1e-4)
    # Both avatars are in the picture, and the refinement did something.
    assert wanted["mask"].max(axis=(0, 1)).min() > 0.9
    assert np.abs(passes["Raw"] - passes["Combined"]).max() > 0.01


@pytest.mark.parametrize("kind", ["crop", "keep"])
def test_border_is_a_part_of_the_full_picture(passes_of, kind):
    _, passes, wanted = passes_of(kind)
    wanted = wanted["combined"]
    height, width = wanted.shape[:2]
    x0, x1, y0, y1 = int(0.3 * width), int(0.71 * width), int(0.2 * height), int(0.6 * height)
    part = wanted[height - y1 : height - y0, x0:x1]
    assert part[..., 3].max() > 0.9
    if kind == "crop":
        np.testing.assert_allclose(passes["Combined"], part, atol=2e-5)
    else:
        whole = np.zeros_like(wanted)
        whole[height - y1 : height - y0, x0:x1] = part
        np.testing.assert_allclose(passes["Combined"], whole, atol=2e-5)


def test_avatars_take_the_scenes_light(render_script, blender_version):
    result = render_script("engine_light.py", python=blender_version)
    assert result["studio_ignores_lamps"] <= CHANNEL_STEP
    assert result["same_cover"] <= CHANNEL_STEP
    left, right = result["sun"]
    assert right > 2 * left  # the sun stands at the picture's right
    assert abs(result["flat"][0] - result["flat"][1]) < 0.3 * result["flat"][0]
    assert result["shaded"][1] < 0.3 * right
    assert result["no_photo"] <= CHANNEL_STEP  # neither a photo's light nor the lamp's
    left, right = result["photo"]
    assert left > 2 * right  # the photo's light is from the other side than the lamp's
    assert result["shadow_goes"] <= CHANNEL_STEP
    assert result["linked"] <= CHANNEL_STEP
    assert result["dark"] == result["intensity_off"] == result["linked_to_others"] == result["excluded"] == 0
    assert result["blue"][2] > 2 * result["blue"][0]
    assert result["not_normalized"] == pytest.approx({"POINT": 1.0, "SUN": 1.0, "AREA": 1.0})  # watts by its area, as in Cycles
    assert "POINT" in result["nan"]
    assert "correct it in the scene" in result["nan"]
    assert result["unread"] == ""
    # nine numbers hold the light of a picture of hard edges within some percent of the brightest
    np.testing.assert_allclose(result["ours"], result["cycles"], atol=0.035)
    assert np.ptp(result["cycles"]) > 0.2
    np.testing.assert_allclose(result["nodes"], [[0.5, 1.5, 2.5]] * 2, rtol=2e-2)  # an emission's color and strength
    assert not any(result["unlinked"])
    assert result["portal"] == [1, 0.0, 0.0, 0.0]  # a lamp less, and dark in Cycles


def test_sliders_of_light_take_keys_and_a_world_an_exr_file(render_script, blender_version):
    result = render_script("engine_light_keys.py", python=blender_version)
    for name in ("light_intensity", "skin_gloss", "skin_detail", "skin_scattering", "shadow_softness"):
        begins, keyed, changed = result[name]
        assert begins <= CHANNEL_STEP, name
        assert keyed <= CHANNEL_STEP, name
        assert name == "skin_detail" or changed > 3 * CHANNEL_STEP, name  # the texels of these weights are too long for pores
    np.testing.assert_allclose(result["exr"], result["pixels"], rtol=2e-3)  # the file has half floats
    assert np.ptp(np.array(result["exr"]).mean(1)) > 0.2
    assert result["lit_by_exr"] > 10
    assert "sky.exr" in result["gone"]


def test_a_world_of_other_nodes_is_baked(render_script, blender_version):
    result = render_script("engine_world.py", python=blender_version)
    assert "until its nodes are baked" in result["unread"]
    np.testing.assert_allclose(result["unbaked"], 0.5, atol=1e-4)
    assert result["finished"] == ["FINISHED"]
    assert result["read"] == result["read_again"] == ""
    # light that leans to one side, on a plane that faces it 2/3, across it 2 / (3 pi), away from it none
    ways = np.repeat(np.eye(3), 2, 0) * np.array([1.0, -1.0] * 3)[:, None]
    expected = np.where(ways > 0, 2 / 3, np.where(ways < 0, 0.0, 2 / (3 * np.pi)))
    np.testing.assert_allclose(result["baked"], expected, atol=0.03)
    assert result["left"] == [0, 1]
    assert "changed" in result["changed"]
    np.testing.assert_allclose(result["again"], 2 * expected, atol=0.06)
    assert result["images"] == 1
    assert result["missing"].startswith("ConfigError: The picture Sky of the world is missing")
    np.testing.assert_array_equal(result["black"], np.zeros((6, 3)))
    assert result["nan"].startswith("ConfigError: The world's light has a strength that is not finite")
    assert result["nothing"]


def test_avatars_wear_hair_of_strands(render_script, blender_version):
    result = render_script("engine_hair.py", python=blender_version)
    assert result["own"] <= CHANNEL_STEP
    own, afro = result["cover"]
    assert afro > 1.1 * own
    long, short = result["beside_neck"]
    assert long > 1.2 * short
    dark, grey = result["brightness"]
    assert grey > dark + 5
    assert result["listed"][:2] == ["OWN", "NONE"]
    assert len(result["listed"]) >= 18


def test_film_and_scene(render_script, blender_version):
    result = render_script("engine_scene.py", python=blender_version)
    for exact in ("transparent", "world", "occlusion_off", "wall_hidden", "wall_behind", "unoccluded_right", "override"):
        assert result[exact] <= CHANNEL_STEP, exact
    assert result["holdout_left"] == 0
    assert result["holdout_right"] == 255
    assert result["holdout_behind"] >= 254
    assert result["holdout_corner"] == 0
    assert result["occluded_left"] == 0
    assert result["instance_left"] == 0
    assert 0.01 < result["text_hides"] < 0.5
    assert result["avatar_holdout"] < 20
    assert result["beside_holdout"] == 255
    assert result["hidden"] == 0
    assert result["agx_alpha"] <= CHANNEL_STEP
    assert result["agx_differs"] > 5
    assert result["agx_error"] <= CHANNEL_STEP


def test_kept_depths_of_meshes_are_never_old(render_script, blender_version):
    found = render_script("engine_occluders.py", python=blender_version, timeout=400)
    assert found["drawn"][0] == 1
    assert sum(found["drawn"]) <= 2
    assert found["drawn"][-2:] == [0, 0]
    assert len(found["changes"]) == 18
    for name, (from_fresh, from_last) in found["changes"].items():
        assert from_fresh == 0, name
        assert from_last > 20, name
    assert found["left_hides"] > 0.001
    assert found["right_hides"] > 0.005
    assert found["swapped"] > 100
    assert found["swapped_fresh"] == 0
    assert found["errors"] < 1e-6
    assert found["draws"] < 48
    assert found["left"] == 0


def test_errors_say_what_is_wrong_and_leave_no_file(run_blender, weights, tmp_path, blender_version):
    done = run_blender("engine_errors.py", weights, tmp_path, python=blender_version, environment=ENVIRONMENT)
    messages, left = done.result["messages"], done.result["left"]
    wanted = {
        "nan": "jawOpen is not a finite number",
        "missing_file": "missing.grmm does not exist; choose the file again with Relink Avatar",
        "animation": "missing.grmm does not exist",
        "broken_file": "broken.grmm",
        "broken_file_exr": "broken.grmm",
        "defect": "a defect",
        "memory": "Not enough memory",
        "no_camera": "camera",
        "panoramic": "panoramic",
        "uneven_scale": "uniform positive scale",
        "empty_border": "",
        "unwritable": "",
        "no_runtime": "no_python",
    }
    for name, text in wanted.items():
        assert messages[name], name
        assert text in messages[name], name
        assert left[name] == [], name
        assert "Traceback" not in messages[name]
        assert len(messages[name].removeprefix("Error: ").splitlines()) <= 2, name
    for name in ("worker", "killed_between", "killed_during"):
        assert messages[name] == "", name
        assert left[name] == ["picture.png"], name
    assert done.result["after"] <= CHANNEL_STEP
    assert done.result["worker"] == "worker"
    assert done.result["world"] == pytest.approx([255, 0, 0, 255])
    # Nothing to be seen of an avatar: the background, and a warning each time, but for holdouts.
    assert done.result["hidden"] == 0
    assert done.output.count("no visible GRMM avatar") == 3


def test_renders_that_end_before_they_are_done(render_script, blender_version):
    found = render_script("engine_stops.py", python=blender_version)
    wanted = {
        "interrupted": "The render was interrupted",
        "cancelled": "cancelled",
        "stopped_while_drawing": "cancelled",
        "disk_full": "is full",
        "newer_version": "format 99, newer than",
        "other_weights": "",  # carried over to those that are here
        "other_head": "head model 'flame'",
        "cut": "cut.grmm is not a readable",
        "thin_border": "small",
        "same": "",
    }
    assert found["waited"] < 30.0  # of a minute
    assert found["loaded"]
    assert set(found["messages"]) == set(wanted)
    for name, text in wanted.items():
        message = found["messages"][name]
        assert text in message, name
        assert bool(message) == bool(text), name
        assert "Traceback" not in message, name
    # Finished frames stay, nothing else is there.
    kept = {"interrupted": ["frame_0001.png", "frame_0002.png"], "cancelled": ["frame_0001.png", "frame_0002.png"]}
    for name, files in found["left"].items():
        assert files == (["picture.png"] if name in ("same", "other_weights") else kept.get(name, [])), name
    # In a window each frame but the first begins with the picture of the one before, and ends with its own.
    assert found["written"] == 2 + 1 + 1
    assert found["shown_before"] <= CHANNEL_STEP
    assert (found["stretched"], found["smaller"], found["other"]) == (True, [2, 3, 2], True)
    assert found["asked"] == 2
    for shown in found["progress"]:
        assert shown == sorted(shown)
        assert (shown[0], shown[-1]) == (0.0, 1.0)
        assert len(shown) > 3
    assert found["texts"][:2] == ["GRMM: reading the scene", "GRMM: opening avatars"]
    assert "GRMM: drawing 1 avatar" in found["texts"]
    assert found["memory"] > 50  # MiB: a process with a model in it
    assert found["after"] <= CHANNEL_STEP


def test_copied_undone_deleted_and_linked_heads_render(render_script, blender_version):
    found = render_script("lifecycle_render.py", python=blender_version)
    assert found["alone"] <= CHANNEL_STEP
    assert found["covered"] > 0.05
    copies, undo, libraries = found["copies"], found["undo"], found["libraries"]
    for kind in ("full", "linked"):
        assert copies[kind] <= CHANNEL_STEP, kind
        assert copies[f"{kind}_seen"] > 20, kind
        assert copies[f"{kind}_deleted"] <= CHANNEL_STEP, kind
    assert undo["changed"] > 20
    assert undo["undone"] <= CHANNEL_STEP
    assert undo["redone"] <= CHANNEL_STEP
    assert found["off"]["gone"]
    assert found["off"]["picture"] <= CHANNEL_STEP
    for name in ("reloaded", "appended", "linked", "overridden", "override_changed"):
        assert libraries[name] <= CHANNEL_STEP, name
    assert libraries["override_seen"] > 20


_seen: dict[str, dict[str, np.ndarray]] = {}  # pictures of `engine_more.py` by Blender version and name


def test_layers_stereo_blur_and_visibility(render_script, blender_version, tmp_path):
    found = render_script("engine_more.py", python=blender_version)
    assert max(found["layers"]) <= CHANNEL_STEP
    assert found["cut_outside"] <= CHANNEL_STEP
    layers = read_exr(tmp_path / "layers.exr")
    with np.load(tmp_path / "layers.npz") as archive:
        for name, key in (("ViewLayer", "first"), ("Second", "second")):
            alpha = next(layers[channel] for channel in layers if channel.startswith(f"{name}.") and channel.endswith(".A"))
            np.testing.assert_allclose(alpha, archive[key][..., 3] / 255, atol=2e-3)
    # Each avatar hides what of the other is behind it.
    assert found["mutual"] <= CHANNEL_STEP
    assert found["core"] > 0.02
    assert found["front_is_seen"] < 3.0
    assert max(found["stereo"]) <= CHANNEL_STEP
    assert found["eyes_differ"] > 30
    assert found["blur"] <= 2 * CHANNEL_STEP
    assert found["blur_differs"] > 10
    assert found["frame_after_blur"] == 2
    assert found["inside"] <= CHANNEL_STEP
    assert found["inside_covered"] > 0.2
    assert found["away"] == 0
    for name in ("one_hidden", "viewport_hidden", "collection_hidden"):
        assert found[name] <= CHANNEL_STEP, name
    _seen[blender_version] = {path.name: _pixels(path) for path in tmp_path.glob("*.png")}


def test_both_blenders_make_the_same_pictures():
    if len(_seen) < 2:
        pytest.skip("needs both Blenders")
    one, other = _seen.values()
    assert len(one) > 10
    for name, picture in one.items():
        assert np.abs(picture.astype(float) - other[name]).max() <= 1, name


def test_frames_in_any_order_and_process_are_the_same(render_script, blender_version, tmp_path):
    render_script("engine_frames.py", "make", python=blender_version)
    files = render_script("engine_frames.py", "open", python=blender_version)["files"]
    assert len(files) == 4 + 4 + 2
    pictures = {name: (tmp_path / name).read_bytes() for name in files}
    for name in files:
        frame = name.rpartition("_")[2]
        np.testing.assert_array_equal(_pixels(tmp_path / name), _pixels(tmp_path / f"forwards_{frame}"), err_msg=name)
    assert len({pictures[name] for name in files if name.startswith("forwards")}) == 4


def test_keys_on_the_slider_deepen_the_furrows_of_a_lifted_brow(render_script, blender_version):
    seen = render_script("engine_wrinkles.py", python=blender_version)
    assert seen["at_rest"] == 0.0
    assert seen["value"] == 2.0
    assert 0.0 < seen["half"] < seen["whole"]


def test_two_machines_of_a_farm_render_what_one_does(render_script, blender_version, tmp_path):
    """Odd and even frames in two processes, one of them from the last to the first; a third draws what a lost one left."""
    whole = render_script("engine_farm.py", "make", "one", python=blender_version)
    assert whole["drawn"] == list(range(1, 9))
    odd = render_script("engine_farm.py", "render", "two", 1, 3, 5, 7, python=blender_version)
    even = render_script("engine_farm.py", "render", "two", 8, 6, 4, 2, python=blender_version)
    assert odd["drawn"] + even["drawn"] == [1, 3, 5, 7, 8, 6, 4, 2]
    (tmp_path / "two" / "frame_0004.png").unlink()
    assert render_script("engine_farm.py", "render", "two", python=blender_version)["drawn"] == [4]
    for number in range(1, 9):
        name = f"frame_{number:04d}.png"
        np.testing.assert_array_equal(_pixels(tmp_path / "two" / name), _pixels(tmp_path / "one" / name), err_msg=name)
    assert len(list((tmp_path / "two").iterdir())) == 8


def test_frames_are_the_same_on_one_and_two_threads(render_script, tmp_path):
    pictures = {}
    for threads, what in ((1, "make"), (2, "render")):
        render_script("engine_farm.py", what, f"threads{threads}", 2, 7, threads=threads)
        pictures[threads] = [_pixels(tmp_path / f"threads{threads}" / f"frame_000{number}.png") for number in (2, 7)]
    np.testing.assert_array_equal(pictures[1], pictures[2])


_NIGHT = [pytest.param(engine, 200, 50, marks=pytest.mark.slow) for engine in ("plain", "torch")]


@pytest.mark.parametrize(("engine", "frames", "kills"), [("plain", 12, 3), *_NIGHT])
def test_an_animation_survives_the_deaths_of_its_worker(render_script, engine, frames, kills):
    """The 4.5 of the tests has both engines, and its worker runs in its own Python."""
    result = render_script("engine_killed.py", engine, frames, kills, timeout=1500.0)
    assert (result["kind"], result["engine"], result["kills"]) == ("worker", engine, kills)
    assert result["restarts"] >= kills
    assert (result["same"], result["files"]) == (frames, frames)


def _pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGBA"))
