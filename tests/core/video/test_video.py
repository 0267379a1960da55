"""Performance capture from a video, against avatars whose weights are known."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from videos import filmed, turned_by_a_quarter, write_sound, write_video

from grmm_core.avatar.library import library_path
from grmm_core.cli import main
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import CancelledError, ConfigError, FileAccessError, FileFormatError, NoFaceError
from grmm_core.fitting.landmark_priors import LIPS
from grmm_core.fitting.point_rig import LandmarkRig
from grmm_core.formats import format_to_read
from grmm_core.head.open_head import load_open_head
from grmm_core.performance import Performance
from grmm_core.video.actor import find_actor
from grmm_core.video.api import track
from grmm_core.video.finishing import fill_gaps, gap_warning, steady_gaze, whole_blinks
from grmm_core.video.following import follow
from grmm_core.video.reading import VideoFile
from grmm_core.video.request import TrackRequest

FPS, COUNT, SIZE = 15, 30, 256
PERSON = "bald"
JAW, SMILE = ARKIT_NAMES.index("jawOpen"), [ARKIT_NAMES.index(f"mouthSmile{side}") for side in ("Left", "Right")]
BLINK = [ARKIT_NAMES.index(f"eyeBlink{side}") for side in ("Left", "Right")]
DOWN = ARKIT_NAMES.index("eyeLookDownLeft")


@dataclasses.dataclass
class Take:
    """A filmed performance: `weights` [T, 52] and `turn` [T] (radians to a side) are what was played in `frames`."""

    video: Path
    frames: list[np.ndarray]
    weights: np.ndarray
    turn: np.ndarray


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Take:
    """Two seconds of a head that speaks, smiles, blinks once and looks around."""
    times = np.arange(COUNT) / FPS
    weights = np.zeros((COUNT, len(ARKIT_NAMES)), np.float32)
    weights[:, JAW] = 0.25 - 0.25 * np.cos(2.0 * np.pi * times)
    weights[:, SMILE] = (0.4 - 0.4 * np.cos(np.pi * times))[:, None]
    weights[10:13, BLINK] = np.array([0.7, 1.0, 0.6])[:, None]
    turn = 0.3 * np.sin(np.pi * times)
    frames = filmed(f"library:{PERSON}", weights, turn, SIZE)
    return Take(write_video(tmp_path_factory.mktemp("take") / "take.mp4", frames, FPS), frames, weights, turn)


@pytest.fixture(scope="module")
def tracked(take: Take, tmp_path_factory: pytest.TempPathFactory) -> Performance:
    """What is found in it, as it was written."""
    output = tmp_path_factory.mktemp("tracked") / "take.json"
    assert main(["track", str(take.video), "-o", str(output), "--threads", "1"]) == 0
    return format_to_read(output, "performance").read(output)


def test_mouth_lids_and_head_move_as_they_did(take: Take, tracked: Performance) -> None:
    assert tracked.frame_count == COUNT
    assert tracked.fps == pytest.approx(FPS)
    rig = LandmarkRig(load_open_head())
    others = np.zeros(rig.expression_count - len(ARKIT_NAMES))

    def lips(weights: np.ndarray) -> np.ndarray:
        still = np.zeros(rig.shape_count), np.zeros((5, 3))
        moved = np.stack([rig.positions(still[0], np.concatenate([row, others]), still[1])[list(LIPS)] for row in weights])
        return (moved - moved.mean(0)).ravel()

    assert np.corrcoef(lips(take.weights), lips(tracked.weights))[0, 1] > 0.9
    assert np.corrcoef(take.weights[:, JAW], tracked.weights[:, JAW])[0, 1] > 0.9
    assert tracked.weights[10:13, BLINK].max(0).min() > 0.85
    assert tracked.weights[[2, 6, 18, 24]][:, BLINK].max() < 0.4
    assert tracked.head_rotation is not None
    found = tracked.head_rotation[:, 1]
    assert np.abs(found - found.mean() - take.turn + take.turn.mean()).max() < np.radians(4.0)


def test_a_phone_held_upright_is_turned(take: Take, tmp_path: Path) -> None:
    lying = write_video(tmp_path / "lying.mp4", [np.rot90(frame, 1) for frame in take.frames[:6]], FPS)
    upright = turned_by_a_quarter(lying, tmp_path / "upright.mp4")
    with VideoFile(upright) as video:
        shown = [pixels for _, pixels in video.frames()]
    difference = np.abs(shown[3].astype(int) - take.frames[3].astype(int)).mean()
    assert difference < 3.0


def test_frames_without_the_face_are_filled_and_said(take: Take, tmp_path: Path) -> None:
    frames = [frame if not 8 <= index < 18 else np.full_like(frame, 90) for index, frame in enumerate(take.frames)]
    video = write_video(tmp_path / "gap.mp4", frames, FPS)
    done = track(TrackRequest(video, tmp_path / "gap.json", threads=1))
    assert "not seen from 0.5 to 1." in " ".join(done.performance.warnings)
    assert done.performance.frame_count == COUNT
    between = done.performance.weights[8:18, JAW]
    assert np.abs(np.diff(between, 2)).max() < 1e-3  # a straight line


def test_uneven_frames_become_even_ones(take: Take, tmp_path: Path) -> None:
    kept = [index for index in range(24) if index % 5 != 3]
    video = write_video(tmp_path / "vfr.mp4", [take.frames[i] for i in kept], FPS, [i / FPS for i in kept])
    done = track(TrackRequest(video, tmp_path / "vfr.json", threads=1)).performance
    steps = np.diff(done.times)
    assert np.allclose(steps, steps[0], atol=1e-6)
    assert done.duration == pytest.approx(23 / FPS, abs=0.1)
    at = np.interp(done.times, np.arange(COUNT) / FPS, take.weights[:, JAW])
    assert np.corrcoef(at, done.weights[:, JAW])[0, 1] > 0.9


def test_the_chosen_face_of_two_is_followed(take: Take) -> None:
    small = [frame[::2, ::2] for frame in take.frames[:6]]
    pairs = [np.concatenate([frame, np.pad(half, ((64, 64), (64, 64), (0, 0)), mode="edge")], 1)
             for frame, half in zip(take.frames, small, strict=False)]  # fmt: skip
    for face, side in ((0, False), (1, True)):
        found = follow(enumerate(pairs), "two.mp4", face=face)
        assert found.seen.all()
        assert (found.landmarks[..., 0].mean(1) > SIZE).tolist() == [side] * len(pairs)
    with pytest.raises(NoFaceError, match="begins with 2 faces; there is no number 3"):
        follow(enumerate(pairs), "two.mp4", face=2)


def test_the_persons_own_avatar_gives_the_shape(take: Take, tmp_path: Path) -> None:
    person = library_path(PERSON)
    done = track(TrackRequest(take.video, tmp_path / "own.json", person=person, end=0.9, threads=1))
    assert np.corrcoef(take.weights[: done.performance.frame_count, JAW], done.performance.weights[:, JAW])[0, 1] > 0.9


def test_a_cancelled_capture_leaves_no_file(take: Take, tmp_path: Path) -> None:
    output = tmp_path / "take.json"
    with pytest.raises(CancelledError):
        track(TrackRequest(take.video, output, threads=1), cancelled=lambda: True)
    assert not output.exists()


def test_a_video_of_unknown_length_can_be_cancelled(take: Take) -> None:
    def stop(_share: float, _message: str = "") -> None:
        raise CancelledError("The performance capture was cancelled.")

    with pytest.raises(CancelledError):
        follow(enumerate(take.frames), "take.webm", expected=None, progress=stop)


def test_what_is_no_video_of_a_face_is_one_sentence(take: Take, tmp_path: Path) -> None:
    whole = take.video.read_bytes()
    (tmp_path / "text.mp4").write_text("not a video")
    (tmp_path / "half.mp4").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.mp4").write_bytes(b"")
    grey = write_video(tmp_path / "grey.mp4", [np.full((128, 128, 3), 90, np.uint8)] * 6, FPS)
    for name in ("text.mp4", "half.mp4", "empty.mp4"):
        with pytest.raises(FileFormatError, match=f"{name} (is not a readable video|has no pictures)"):
            track(TrackRequest(tmp_path / name, tmp_path / "out.json"))
    heard = write_sound(tmp_path / "heard.mov", np.zeros(1600, np.int16), 16000, 16000, 1)
    with pytest.raises(FileFormatError, match=r"heard\.mov has sound but no pictures; .*grmm speak\.$"):
        track(TrackRequest(heard, tmp_path / "out.json"))
    with pytest.raises(NoFaceError, match=r"No face was found in grey\.mp4"):
        track(TrackRequest(grey, tmp_path / "out.json"))
    with pytest.raises(FileAccessError, match="does not exist"):
        track(TrackRequest(tmp_path / "none.mp4", tmp_path / "out.json"))
    with pytest.raises(FileAccessError, match="is a folder"):
        track(TrackRequest(tmp_path, tmp_path / "out.json"))
    with pytest.raises(FileAccessError, match="begin before second 99"):
        track(TrackRequest(take.video, tmp_path / "out.json", start=99.0))
    with pytest.raises(FileAccessError, match="make it or choose"):
        track(TrackRequest(take.video, tmp_path / "no" / "out.json"))
    assert not (tmp_path / "out.json").exists()


def test_events_end_with_the_file(take: Take, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    request = TrackRequest(take.video, tmp_path / "é.json", start=0.2, end=0.8, threads=1)
    assert main(["track", "--events", *request.arguments()]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    fractions = [event["fraction"] for event in events if event["event"] == "progress"]
    assert fractions == sorted(fractions)
    assert events[-1]["event"] == "done"
    assert events[-1]["performance"] == str(request.output)
    assert events[-1]["frames"] == 10


def bad_requests() -> Iterator[tuple[dict[str, object], str]]:
    yield {"output": "take.txt"}, "does not end in .json"
    yield {"start": -1.0}, "give 0 or more"
    yield {"start": float("nan")}, "give 0 or more"
    yield {"start": 2.0, "end": 1.0}, "must come after"
    yield {"face": -1}, "no face 0"
    yield {"threads": -2}, "threads are not possible"


@pytest.mark.parametrize(("changes", "message"), list(bad_requests()))
def test_requests_that_cannot_be_meant_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        TrackRequest(**{"recording": "a.mp4", "output": "take.json", **changes})  # type: ignore[arg-type]


def test_half_blinks_become_whole_and_open_eyes_stay() -> None:
    times = np.arange(90) / 30.0
    weights = np.full((90, len(ARKIT_NAMES)), 0.1)
    for begin in (20, 50, 80):
        weights[begin : begin + 5, BLINK] = np.array([0.3, 0.55, 0.6, 0.5, 0.25])[:, None]
    weights[30:47, BLINK[0]] = 0.5  # a wink that lasts is no blink, and stays half open
    result = whole_blinks(weights, times)
    assert np.allclose(result[[22, 52, 82]][:, BLINK], 1.0, atol=0.02)
    assert np.allclose(result[:18], weights[:18])
    still = whole_blinks(np.full_like(weights, 0.4), times)
    assert np.allclose(still, 0.4)


def test_eyes_do_not_sink_in_a_blink() -> None:
    times = np.arange(30) / 30.0
    weights = np.zeros((30, len(ARKIT_NAMES)))
    weights[10:15, BLINK[0]], weights[10:15, DOWN] = 0.8, 0.7
    weights[15:, DOWN] = 0.2
    result = steady_gaze(weights, times)
    assert result[10:15, DOWN].max() < 0.21
    assert np.allclose(np.delete(result, DOWN, 1), np.delete(weights, DOWN, 1))


def test_gaps_are_bridged_and_ends_held() -> None:
    times, seen = np.array([0.0, 0.1, 0.2, 0.9, 1.0, 1.1]), np.array([False, True, True, False, True, False])
    values = np.array([9.0, 1.0, 2.0, 9.0, 4.0, 9.0])[:, None]
    assert np.allclose(fill_gaps(values, seen, times)[:, 0], [1.0, 1.0, 2.0, 3.75, 4.0, 4.0])
    assert gap_warning(seen, times).startswith("The face is not seen from 0.2 to 1.0 s (50 % of all frames)")
    assert gap_warning(np.ones(6, bool), times[:3].repeat(2)) == ""


def test_a_tilted_camera_changes_nothing_about_the_person(take: Take) -> None:
    """What brows and lids of a face differ by belongs to the head: the same frames, rolled by 25 degrees, give the same."""
    rig = LandmarkRig(load_open_head())
    upright = follow(((i / FPS, frame) for i, frame in enumerate(take.frames[:8])), "take.mp4")
    angle = np.radians(25.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points = upright.landmarks.copy()
    points[..., :2] = (points[..., :2] - SIZE / 2) @ turn + SIZE / 2
    tilted = dataclasses.replace(upright, landmarks=points)
    first, second = (find_actor(followed, rig).offsets for followed in (upright, tilted))
    assert np.abs(first).max() > 0.02
    assert np.abs(first - second).max() < 0.3 * np.abs(first).max()


def test_a_person_is_the_head_with_that_shape() -> None:
    rig, rng = LandmarkRig(load_open_head()), np.random.default_rng(0)
    shape, pose = rng.normal(size=rig.shape_count), rng.normal(size=(5, 3)) * 0.1
    expression = np.zeros(rig.expression_count)
    expression[: len(ARKIT_NAMES)] = rng.uniform(size=len(ARKIT_NAMES))
    person = rig.of_person(shape, np.ones(len(ARKIT_NAMES)))
    known = expression[: len(ARKIT_NAMES)]
    assert np.allclose(person.positions(np.zeros(0), known, pose), rig.positions(shape, expression, pose), atol=1e-12)
    own, whole = person.linearise(np.zeros(0), known, pose), rig.linearise(shape, expression, pose)
    assert own[1].shape[2] == 0
    assert np.allclose(own[2], whole[2][..., : len(ARKIT_NAMES)], atol=1e-9)
    assert np.allclose(own[3], whole[3], atol=1e-6)
