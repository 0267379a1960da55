"""Avatars from photos in Blender: the job that it follows, the choice of photos, errors, and a whole fit."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender, find_python
from PIL import Image

from grmm_core.controls.frame import Controls
from grmm_core.geometry.camera import Camera
from grmm_core.jobs.stages import FIT
from grmm_core.pictures.images import encode_png, quantize

pytestmark = pytest.mark.blender
PHOTO_SIDE = 320
FINEST = 2.0  # pixels of the photo
MOST_ERROR = 0.06  # of 0..1; a person of other weights, or a camera that is off by a few pixels, is beyond it


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photo of nobody: the default avatar, rendered."""
    from grmm_core.session import Instance, RenderOptions, create_session

    folder = tmp_path_factory.mktemp("photos")
    with create_session("local") as session:
        info = session.open("default")
        camera = Camera.orbit(512, 512, 8.0, 2.0, 1.1, 20.0)
        buffers = session.render([Instance(info.id, Controls())], camera, RenderOptions())
    image = buffers["rgb"] + (1.0 - buffers["alpha"]) * 0.6
    (folder / "face.png").write_bytes(encode_png(quantize(image)))
    (folder / "text.jpg").write_text("no picture")
    return folder


def environment() -> dict[str, str]:
    return {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}


@pytest.mark.parametrize("version", ["4.5", "5.2"])
def test_a_photo_that_its_tag_turns_stands_upright_behind_its_camera(run_blender: RunBlender, tmp_path: Path, version: str):
    find_python(version)
    rows, columns = np.mgrid[:64, :96]
    seen = np.stack([2 * columns, 3 * rows, 255 - columns - rows], 2).astype(np.uint8)
    stored = {1: seen, 3: seen[::-1, ::-1], 6: np.rot90(seen, 1), 8: np.rot90(seen, -1)}
    for orientation, pixels in stored.items():
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.fromarray(np.ascontiguousarray(pixels)).save(tmp_path / f"{orientation}.png", exif=exif)
    other = tmp_path / "other.png"  # no longer the photo that was fitted
    Image.fromarray(np.ascontiguousarray(seen.transpose(1, 0, 2))).save(other)
    photos = [tmp_path / f"{orientation}.png" for orientation in stored]
    done = run_blender("photo_background.py", *photos, other, python=version)
    for found, orientation in zip(done.result["shown"], stored, strict=False):
        assert found["shown"]
        assert found["packed"] == (orientation != 1)
        np.testing.assert_allclose(found["pixels"], seen / 255.0, atol=0.01)
    assert done.result["shown"][-1] == {"shown": False}
    assert done.result["kept"] == 3


@pytest.mark.parametrize("version", ["4.5", "5.2"])
def test_photos_are_looked_at(run_blender: RunBlender, folder: Path, version: str):
    find_python(version)
    done = run_blender("fit_panel.py", folder, "look", python=version, environment=environment(), timeout=400.0)
    said = done.result["statuses"]
    assert said["done"] == ["done", "a.grmm", 1.0, ["a.jpg", 2, "f.png"], "p.png"]
    assert said["looked"] == "done"
    assert said["fell"] == 0.35
    assert said["failed"] == ["failed", "No face was found."]
    assert said["crashed"][0] == "failed"
    assert "memory" in said["crashed"][1]
    assert said["crashed"][2] == pytest.approx(0.35)
    assert said["lacking"][0] == "failed"
    assert "nothing_of_this_name" in said["lacking"][1]
    assert said["silent"][0] == "failed"
    assert "without an avatar" in said["silent"][1]
    assert said["nameless"][0] == "failed"
    assert said["garbage"] == ["done", "b.grmm", 1.0]
    assert said["stopped"][0] == "failed"
    assert "code 3 (Illegal instruction of some library)" in said["stopped"][1]
    assert said["real"][0] == "cancelled"
    assert said["cancelled"][0] == "cancelled"
    assert said["cancelled"][1] == "The fit was cancelled."
    assert said["resumable"] == ["cancelled", "The fit was cancelled; it can be resumed."]
    look = done.result["look"]
    assert not look["poll_without"]
    assert look["photos"] == 1  # the same file is not added twice
    assert look["faces"] == 1
    assert look["found"] > 20_000
    assert "text.jpg" in look["broken"]
    assert "folder" in look["no_folder"]
    assert "choose a number from 1 to 1" in look["wrong_face"]
    assert look["faces_then"] == 1  # the picture of a wrong choice is shown, too
    assert look["found_then"] > 20_000


def test_a_finished_fit_is_one_step_to_undo_and_asks_before_it_replaces(
    run_blender: RunBlender, blender_version: str, tmp_path: Path
):
    found = run_blender("fit_scene.py", tmp_path, python=blender_version).result
    assert found["waits"]
    assert not found["waits_then"]
    assert found["note"] == "Ada is in the scene, with a camera that shows the photo."
    assert found["one"] == {"heads": [0.0], "cameras": ["Ada rig"]}
    assert 0.01 < found["frames"][0] < 0.15  # a camera is no larger than a head
    assert found["beside"] == "Ada is in the scene, beside the head that was there, with a camera that shows the photo."
    assert found["two"] == {"heads": [0.0, 0.4], "cameras": ["Ada rig", "Ada rig.001"]}
    assert found["undone"] == found["one"], "the earlier avatar keeps its camera"
    assert found["undone_twice"] == {"heads": [], "cameras": []}
    assert found["redone"] == found["one"]
    assert "go to object mode first" in found["edit_mode"]
    assert found["still_waits"]
    assert not found["can_add"]
    assert found["added_later"] == ["Ada rig"]
    assert found["note_of_before"] == ""
    assert found["no_job"].startswith("There is no fit;")
    assert found["begun_elsewhere"] == "ada.grmm, begun in another file, is finished; press Add to Scene to have it here."
    assert found["not_added"] == {"heads": [], "cameras": []}
    assert found["offered"]
    assert found["added_here"] == ["Ada rig"]
    assert found["while_it_runs"] == ["UI"]  # drawing the whole viewport would take time from the fit
    assert found["looks_again"]
    assert found["there"] == ["RUNNING_MODAL"]
    assert found["asked"] == ["ada.grmm exists already. Choose another avatar file to keep it."]
    assert found["resumed"] == ["FINISHED"]
    assert found["new"] == ["FINISHED"]
    assert found["asked_then"] == 1


@pytest.mark.slow
def test_a_fit_puts_the_avatar_into_the_scene(run_blender: RunBlender, folder: Path):
    done = run_blender("fit_panel.py", folder, "fit", python="4.5", environment=environment(), timeout=900.0)
    said = done.result["fit"]
    assert said["avatar"]
    assert said["background"]
    assert Path(said["source"]).name == "person.grmm"
    from grmm_core.fitting.track import analyse_photo

    face = analyse_photo(folder / "face.png").faces[0]
    irises = face.landmarks[[468, 473], :2] / 512.0  # the subject's right and left
    eyes = np.array(said["eyes"])[::-1]
    assert np.abs(irises - eyes).max() < 0.03


@pytest.mark.slow
def test_a_real_photo_is_cancelled_resumed_and_seen_through_its_camera(
    run_blender: RunBlender, photo_file, tmp_path: Path, record_property
):
    photo = tmp_path / "photo.png"
    with Image.open(photo_file("astronaut")) as whole:
        whole.convert("RGB").resize((PHOTO_SIDE, PHOTO_SIDE), Image.Resampling.LANCZOS).save(photo)
    done = run_blender("fit_photo.py", photo, tmp_path, python="4.5", environment=environment(), timeout=1800.0).result
    assert not done["before"]
    cancelled = done["cancelled"]
    assert cancelled["state"] == "cancelled"
    assert "resumed" in cancelled["message"]
    assert cancelled["growing"]
    places = [FIT.position(stage) for stage in cancelled["stages"]]  # a short one may begin and end between two looks
    assert places == sorted(places)
    assert cancelled["stages"][-1] == "codes"
    assert cancelled["faces"] == [1]
    assert cancelled["left"] == ["person.grmm.fit", "photo.png"]
    assert done["resumable"]
    assert done["rigged"]
    assert "photo.png" in done["origin"]
    assert "agreement" in done["origin"]
    assert done["preview"][0] > 32
    assert done["background"] == "photo.png"
    assert done["preview_seen"].endswith(".png")  # photo beside avatar, while it ran
    assert done["left"] == ["person.grmm", "photo.png"], "the work folder is gone"

    from grmm_core.fitting.blurring import blurred
    from grmm_core.fitting.track import analyse_photo
    from grmm_core.photo.person import person_mask

    found = analyse_photo(photo)
    (face,) = found.faces
    with Image.open(tmp_path / "through_the_camera.png") as shown:
        drawn = np.asarray(shown.convert("RGBA"), np.float32) / 255.0
    mask = person_mask(found.photo.pixels, face.box) > 0.9
    rows = np.arange(PHOTO_SIDE)[:, None]
    head = mask & (rows < face.landmarks[13, 1])  # down to the mouth: the suit's collar, which is no head, begins below the lip
    assert drawn[..., 3][head].mean() > 0.98
    straight = drawn[..., :3] * drawn[..., 3:] + (1.0 - drawn[..., 3:]) * 0.5
    # strands of hair are not the photo's one by one: what is finer than that is smoothed, within the head
    off = (straight - found.photo.pixels) * head[..., None]
    smooth = blurred(off.transpose(2, 0, 1), FINEST) / np.maximum(blurred(np.float32(head)[None], FINEST), 1e-3)
    error = float(np.sqrt(np.square(smooth[:, head]).mean()))
    grey = float(np.sqrt(np.square(found.photo.pixels - found.photo.pixels[head].mean(0))[head].mean()))
    for name, value in (("color_error", error), ("color_error_of_one_color", grey), ("seconds", done["seconds"])):
        record_property(name, value)
    assert error < MOST_ERROR
    assert error < 0.5 * grey
