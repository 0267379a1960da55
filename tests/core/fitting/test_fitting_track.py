"""Real photos to tracks: landmark error, framing, choice of the face, bad input, cancelling."""

from __future__ import annotations

import numpy as np
import pytest
from photos import analyse_picture, two_people
from PIL import Image, ImageFilter
from shape_errors import measure_shapes

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import CancelledError, ConfigError, FileFormatError, NoFaceError, ShapeError
from grmm_core.fitting.track import AnalysedPhoto, analyse_photo, cut_square, frame_of, track_photos
from grmm_core.head.open_head import load_open_head

SIZE = 256
PORTRAITS = ("astronaut", "admiral")


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def analysed(photo_file):
    cache: dict[str, AnalysedPhoto] = {}

    def get(name):
        if name not in cache:
            cache[name] = analyse_photo(photo_file(name))
        return cache[name]

    return get


@pytest.fixture(scope="module")
def tracked(analysed, head):
    cache = {}

    def get(name):
        if name not in cache:
            (cache[name],) = track_photos([analysed(name)], head, size=SIZE)
        return cache[name]

    return get


def posed(track, head):
    return head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))


@pytest.mark.parametrize("name", PORTRAITS)
def test_portraits_are_tracked_closely(tracked, name):
    track = tracked(name)
    assert track.landmark_error < 0.03  # of the eye distance
    assert track.image.shape == (SIZE, SIZE, 3)
    assert 0.4 < np.linalg.norm(track.camera.position) < 4.0
    assert track.presence > 0.9


def test_the_smile_is_found(tracked):
    expression = tracked("astronaut").expression
    serious = tracked("admiral").expression
    smile = ARKIT_NAMES.index("mouthSmileLeft")
    assert expression[smile] > 0.4
    assert serious[smile] < 0.3


def test_the_working_picture_is_framed_as_the_training_pictures(tracked):
    track = tracked("astronaut")
    left, top, side = frame_of(track.camera)
    np.testing.assert_allclose([left, top, side], [0.0, 0.0, SIZE], atol=0.02 * SIZE)  # framed before the refinement


def test_both_cameras_see_the_same(tracked, head):
    track = tracked("astronaut")
    points = posed(track, head)[::50].astype(np.float64)
    rays = []
    for camera in (track.camera, track.photo_camera):
        local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        rays.append(local[:, :2] / local[:, 2:])
    np.testing.assert_allclose(rays[0], rays[1], atol=1e-9)
    assert (track.photo_camera.width, track.photo_camera.height) == (512, 512)


def test_fitted_landmarks_are_those_of_the_track(tracked, head):
    track = tracked("admiral")
    points = head.landmark_positions(posed(track, head), 478).astype(np.float64)
    camera = track.camera
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    pixels = local[:, :2] / local[:, 2:] * camera.fx + [camera.cx, camera.cy]
    np.testing.assert_allclose(pixels, track.landmarks_fitted, atol=0.02)


def test_mask_is_the_person(tracked):
    track = tracked("astronaut")
    x, y = track.landmarks.mean(0).astype(int)
    assert track.mask[y, x] > 0.9
    assert track.mask[:12, :12].mean() < 0.2


def test_the_faces_of_two_people_can_be_chosen(photo_file, head):
    pair = analyse_picture(two_people(photo_file) / np.float32(255.0))
    assert len(pair.faces) == 2
    first, second = (track_photos([pair], head, faces=[i], size=SIZE)[0] for i in (0, 1))
    assert abs(first.photo_camera.world_to_camera[0, 3] - second.photo_camera.world_to_camera[0, 3]) > 0.05
    with pytest.raises(ConfigError, match="no face 2"):
        track_photos([pair], head, faces=[2], size=SIZE)


def test_photos_of_one_person_share_the_shape(analysed, head):
    item = analysed("astronaut")
    tracks = track_photos([item, item], head, size=SIZE)
    np.testing.assert_array_equal(tracks[0].shape, tracks[1].shape)
    assert len(tracks) == 2


def test_a_given_mask_is_used(analysed, head):
    item = analysed("admiral")
    height, width = item.photo.pixels.shape[:2]
    mask = np.zeros((height // 2, width // 2), np.float32)
    mask[:, : width // 4] = 1.0
    (track,) = track_photos([item], head, masks=[mask], size=SIZE)
    middle = int(track.photo_camera.cx * 0 + track.camera.cx)  # the photo's middle column in the working picture
    assert track.mask[SIZE // 2, max(middle - 25, 1)] > 0.9
    assert track.mask[SIZE // 2, min(middle + 25, SIZE - 1)] < 0.1
    with pytest.raises(ShapeError, match="proportion"):
        track_photos([item], head, masks=[np.ones((50, 200), np.float32)], size=SIZE)


def test_progress_grows_and_cancelling_ends_the_work(analysed, head):
    seen = []
    track_photos([analysed("admiral")], head, size=SIZE, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert len(seen) > 4
    with pytest.raises(CancelledError):
        track_photos([analysed("admiral")], head, size=SIZE, cancelled=lambda: True)


def test_a_photo_without_a_face_is_named(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    with pytest.raises(NoFaceError, match=r"noise\.png"):
        analyse_photo(tmp_path / "noise.png")


def test_a_tiny_face_is_refused_in_one_sentence(photo_file, tmp_path):
    portrait = Image.open(photo_file("astronaut")).convert("RGB").resize((80, 80))
    canvas = Image.new("RGB", (500, 400), (120, 120, 130))
    canvas.paste(portrait, (200, 150))
    canvas.save(tmp_path / "far.png")
    with pytest.raises(NoFaceError, match=r"far\.png"):
        analyse_photo(tmp_path / "far.png")


def test_damaged_files_are_refused_in_one_sentence(photo_file, tmp_path):
    (tmp_path / "half.jpg").write_bytes(photo_file("astronaut").read_bytes()[:20000])
    (tmp_path / "text.jpg").write_text("no picture")
    for name in ("half.jpg", "text.jpg"):
        with pytest.raises(FileFormatError, match=name):
            analyse_photo(tmp_path / name)


def test_a_stated_focal_length_is_read(photo_file, tmp_path):
    photo = Image.open(photo_file("admiral")).convert("RGB")
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 72
    photo.save(tmp_path / "exif.jpg", exif=exif)
    assert analyse_photo(tmp_path / "exif.jpg").focal == pytest.approx(72 / 36 * max(photo.size))


def test_no_photo_is_an_error(head):
    with pytest.raises(ConfigError, match="No photo"):
        track_photos([], head)


def test_squares_beyond_the_picture_are_filled():
    picture = np.full((40, 60, 1), 0.75, np.float32)
    result = cut_square(picture, -20.0, -20.0, 80.0, 80, 0.25)[:, :, 0]
    np.testing.assert_allclose(result[25:55, 25:], 0.75, atol=0.01)
    np.testing.assert_allclose(result[:15], 0.25, atol=0.01)
    assert (cut_square(picture, 100.0, 100.0, 30.0, 16, 0.25) == np.float32(0.25)).all()


def test_a_rolled_photo_gives_a_rolled_camera(analysed, head, photo_file, tmp_path):
    photo = Image.open(photo_file("astronaut")).convert("RGB").rotate(20.0, Image.Resampling.BICUBIC)
    photo.save(tmp_path / "rolled.png")
    upright, rolled = (
        track_photos([item], head, size=SIZE)[0] for item in (analysed("astronaut"), analyse_photo(tmp_path / "rolled.png"))
    )
    rolls = [np.degrees(np.arctan2(*t.camera.world_to_camera[[1, 0], 0])) for t in (upright, rolled)]
    assert rolls[0] - rolls[1] == pytest.approx(20.0, abs=3.0)  # turned against the clock, y points down
    assert rolled.landmark_error < 0.04


def test_shapes_are_measured_over_people(analysed, tracked, head):
    track = tracked("astronaut")
    pixels = analysed("astronaut").photo.pixels
    blank = np.full((200, 200, 3), 0.4, np.float32)
    result = measure_shapes(head, [(track.shape, [blank, pixels]), (track.shape, [blank])], 1, size=SIZE)
    assert len(result.millimetres) == 1  # nobody is in the second person's only picture
    assert result.millimetres[0] < 0.1
    assert result.mean_head[0] > 0.5
    with pytest.raises(ConfigError, match="Nobody"):
        measure_shapes(head, [(track.shape, [blank])], 1)


@pytest.mark.parametrize(
    ("name", "spoilt"), [("not sharp enough", lambda p: p.filter(ImageFilter.GaussianBlur(9))), ("cut off by", None)]
)
def test_a_face_out_of_focus_or_beyond_the_edge_is_refused_in_one_sentence(photo_file, analysed, tmp_path, name, spoilt):
    face = analysed("astronaut").faces[0]
    picture = Image.open(photo_file("astronaut")).convert("RGB")
    scale = picture.width / analysed("astronaut").photo.pixels.shape[1]
    left, top, right, bottom = (float(edge) * scale for edge in face.box)
    size = bottom - top
    around = (left - size, top - size, right + size, bottom + size)
    if spoilt is None:
        around = (left + 0.33 * (right - left), *around[1:])  # one eye is outside
    picture = picture.crop(tuple(round(edge) for edge in around))
    picture = picture.resize((512, round(512 * picture.height / picture.width)))
    path = tmp_path / "anna.png"
    (picture if spoilt is None else spoilt(picture)).save(path)
    with pytest.raises(NoFaceError, match=rf"^The face in anna\.png is {name}[^.]*\.$"):
        analyse_photo(path)
    if spoilt is not None:  # a softer picture is taken
        picture.filter(ImageFilter.GaussianBlur(2)).save(path)
        assert len(analyse_photo(path).faces) == 1


def test_a_person_who_does_not_stand_out_is_refused_in_one_sentence(analysed, head):
    photo = analysed("astronaut")
    elsewhere = np.zeros(photo.photo.pixels.shape[:2], np.float32)
    elsewhere[-8:] = 1.0
    with pytest.raises(NoFaceError, match="does not stand out from the background; give a picture of the outline"):
        track_photos([photo], head, size=SIZE, masks=[elsewhere])
    assert len(track_photos([photo, photo], head, size=SIZE, masks=[elsewhere, None])) == 2  # another photo shows the person


def test_a_face_half_behind_a_smooth_thing_is_refused_in_one_sentence(photo_file, analysed, head, tmp_path):
    face, picture = analysed("admiral").faces[0], Image.open(photo_file("admiral")).convert("RGB")
    scale = picture.width / analysed("admiral").photo.pixels.shape[1]
    picture.paste((38, 30, 26), (round(0.5 * (face.box[0] + face.box[2]) * scale), 0, picture.width, picture.height))
    path = tmp_path / "anna.png"
    picture.save(path)
    with pytest.raises(NoFaceError, match=r"^Something hides about [3-6]\d percent of the face in anna\.png; [^.]*\.$"):
        track_photos([path], head, size=SIZE)
