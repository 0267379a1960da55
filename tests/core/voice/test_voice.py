"""Performances from voices, against a voice whose phones are known (`tests/data/SOURCES.md`)."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from videos import write_sound, write_video

from grmm_core.cli import build_parser, main
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import CancelledError, ConfigError, FileAccessError, FileFormatError, GrmmError, RuntimeMissingError
from grmm_core.formats import format_to_read
from grmm_core.head import arkit_gain, load_open_head
from grmm_core.performance.closures import lip_model
from grmm_core.voice.acting import act
from grmm_core.voice.api import FPS, speak
from grmm_core.voice.listening import SILENCE, Heard, Phone, listen, utterances
from grmm_core.voice.mouth import mouth
from grmm_core.voice.request import OTHER, SpeakRequest
from grmm_core.voice.sound import HOP, RATE, loudness, read_sound
from grmm_core.voice.spelling import spelled_sounds, words_of

JAW, CLOSE = ARKIT_NAMES.index("jawOpen"), ARKIT_NAMES.index("mouthClose")
MOUTH = [index for index, name in enumerate(ARKIT_NAMES) if name.startswith(("mouth", "jaw", "tongue"))]
LIPS = frozenset("PBM")


@dataclass(frozen=True)
class Voice:
    """A sentence, its samples and its phones as they truly are."""

    path: Path
    text: str
    samples: np.ndarray
    phones: tuple[Phone, ...]

    @property
    def times(self) -> np.ndarray:
        return np.arange(round(len(self.samples) / RATE * FPS)) / FPS

    def moved(self, heard: Heard) -> np.ndarray:
        return mouth(heard.phones, loudness(self.samples), self.times)


@pytest.fixture(scope="module")
def voice(repository: Path) -> Voice:
    folder = repository / "tests" / "data" / "voice"
    known = json.loads((folder / "voice.json").read_text("utf-8"))
    return Voice(
        folder / "voice.ogg", known["text"], read_sound(folder / "voice.ogg"), tuple(Phone(*p) for p in known["phones"])
    )


@pytest.fixture(scope="module")
def truth(voice: Voice) -> np.ndarray:
    return mouth(voice.phones, loudness(voice.samples), voice.times)


def alike(first: np.ndarray, second: np.ndarray) -> float:
    """Correlation of the mouth's movements, all shapes together."""
    pairs = [(weights - weights.mean(0))[:, MOUTH].ravel() for weights in (first, second)]
    return float(np.corrcoef(*pairs)[0, 1])


def test_lips_follow_what_is_said(voice: Voice, truth: np.ndarray) -> None:
    given, words, sounds = listen(voice.samples, voice.text), listen(voice.samples), listen(voice.samples, english=False)
    assert alike(truth, voice.moved(given)) > 0.95
    assert alike(truth, voice.moved(words)) > 0.85
    assert alike(truth, voice.moved(sounds)) > 0.75
    assert (given.text, given.unknown, given.unplaced) == (" ".join(words_of(voice.text)), (), False)
    assert len(set(words_of(voice.text)) & set(words.text.split())) >= 8
    assert sounds.text == ""
    for heard in (given, words, sounds):
        assert [phone.start for phone in heard.phones[1:]] == [phone.end for phone in heard.phones[:-1]]
        assert heard.phones[0].start == 0.0
        assert heard.phones[-1].end == pytest.approx(len(voice.samples) / RATE)


def test_lips_close_for_p_b_and_m(voice: Voice, truth: np.ndarray) -> None:
    head = load_open_head()
    lips = lip_model(head, arkit_gain(head, np.zeros(0)))
    apart = lips.distance(truth.astype(np.float32)) - lips.rest
    spans = [(phone.start, phone.end) for phone in voice.phones if phone.name in LIPS]
    assert len(spans) >= 5
    for begin, end in spans:
        assert apart[(voice.times >= begin) & (voice.times <= end)].min() < 0.5e-3
    open_vowels = [(p.start, p.end) for p in voice.phones if p.name in ("AE", "AA", "AY", "AO")]
    assert min(apart[(voice.times >= a) & (voice.times <= b)].max() for a, b in open_vowels) > 4e-3


def one_phone(name: str, strength: float = 1.0, levels: np.ndarray | None = None) -> dict[str, float]:
    phones = [Phone(SILENCE, 0.0, 0.5), Phone(name, 0.5, 0.8), Phone(SILENCE, 0.8, 1.3)]
    row = mouth(phones, np.full(130, 60.0) if levels is None else levels, np.array([0.65]), strength)[0]
    return dict(zip(ARKIT_NAMES, row, strict=True))


def test_each_kind_of_phone_has_its_shape() -> None:
    vowel = one_phone("AA")
    assert vowel["jawOpen"] > 2.0 * one_phone("IY")["jawOpen"]
    assert one_phone("UW")["mouthPucker"] > 0.5 > 0.1 > vowel["mouthPucker"]
    assert one_phone("IY")["mouthStretchLeft"] > 0.2
    assert one_phone("F")["mouthRollLower"] > 0.5
    assert one_phone("TH")["tongueOut"] > 0.2
    assert one_phone("SH")["mouthFunnel"] > 0.2 > one_phone("S")["mouthFunnel"]
    assert one_phone("M", strength=0.0)["mouthPressLeft"] == one_phone("M")["mouthPressLeft"] > 0.0
    assert one_phone("AA", strength=0.0)["jawOpen"] == 0.0
    assert one_phone("AA", strength=0.5)["jawOpen"] == pytest.approx(0.5 * vowel["jawOpen"])


def test_lips_round_before_the_vowel_and_quick_speech_opens_less() -> None:
    levels, times = np.full(200, 60.0), np.arange(0.0, 1.5, 0.01)
    before = [Phone(SILENCE, 0.0, 0.5), Phone("T", 0.5, 0.6), Phone("UW", 0.6, 0.9), Phone(SILENCE, 0.9, 1.5)]
    pucker = mouth(before, levels, times)[:, ARKIT_NAMES.index("mouthPucker")]
    assert pucker[55] > 0.3  # in the T
    slow = [Phone("S", 0.0, 0.3), Phone("AA", 0.3, 0.7), Phone("S", 0.7, 1.0)]
    quick = [Phone("S", 0.0, 0.07), Phone("AA", 0.07, 0.13), Phone("S", 0.13, 0.2)]
    assert mouth(quick, levels, times)[:, JAW].max() < 0.7 * mouth(slow, levels, times)[:, JAW].max()


def test_loud_vowels_open_wider() -> None:
    phones = [Phone("AA", 0.0, 0.4), Phone("S", 0.4, 0.6), Phone("AA", 0.6, 1.0)]
    levels = np.where(np.arange(100) < 50, 55.0, 65.0)
    jaw = mouth(phones, levels, np.array([0.2, 0.8]))[:, JAW]
    assert jaw[1] > 1.2 * jaw[0]


def test_the_rest_of_the_face_lives_and_leaves_the_mouth(voice: Voice) -> None:
    levels = loudness(voice.samples)
    times = np.arange(0.0, 20.0, 1.0 / FPS)
    once = [*voice.phones, Phone(SILENCE, voice.phones[-1].end, 5.0)]
    phones = [Phone(phone.name, phone.start + 5.0 * i, phone.end + 5.0 * i) for i in range(4) for phone in once]
    levels = np.tile(np.pad(levels, (0, round(5.0 / HOP) - len(levels)), constant_values=20.0), 4)
    weights, turn = act(phones, levels, times, seed=3)
    assert not weights[:, MOUTH].any()
    blink = weights[:, ARKIT_NAMES.index("eyeBlinkLeft")]
    assert 3 <= int((np.diff((blink > 0.5).astype(int)) == 1).sum()) <= 14
    assert np.radians(1.0) < turn.std(0).max() < np.radians(8.0)
    assert np.abs(np.diff(turn, axis=0)).max() * FPS < np.radians(90.0)  # a second: nobody jerks
    assert weights[:, ARKIT_NAMES.index("browInnerUp")].max() > 0.1
    again, other = act(phones, levels, times, seed=3), act(phones, levels, times, seed=4)
    np.testing.assert_array_equal(again[1], turn)
    assert np.abs(other[1] - turn).max() > np.radians(1.0)
    still = act(phones, levels, times, liveliness=0.0)
    assert not still[0].any()
    assert not still[1].any()


def test_a_text_is_shared_out_over_pauses(voice: Voice, tmp_path: Path) -> None:
    pause = np.zeros(RATE, np.int16)
    longer = np.concatenate([voice.samples, pause, voice.samples, pause, voice.samples])
    assert len(utterances(longer)) == 3
    heard = listen(longer, " ".join([voice.text] * 3))
    assert not heard.unplaced
    assert heard.text.split() == words_of(voice.text) * 3
    period = len(voice.samples) / RATE + 1.0
    middles = [(phone.start + phone.end) / 2 for phone in heard.phones if phone.name == "P"]
    true = [(phone.start + phone.end) / 2 for phone in voice.phones if phone.name == "P"]
    expected = [time + period * index for index in range(3) for time in true]
    assert np.abs(np.array(middles) - expected).max() < 0.1


def test_words_that_no_dictionary_has_are_spelled() -> None:
    assert spelled_sounds("blix") == ("B", "L", "IH", "K", "S")
    assert spelled_sounds("phoode") == ("F", "UW", "D")
    assert spelled_sounds("'") == ("AH",)
    assert words_of("Don\N{RIGHT SINGLE QUOTATION MARK}t \N{EM DASH} say “Zorblax” 3 times") == [
        "don't",
        "say",
        "zorblax",
        "times",
    ]


def test_a_wrong_text_is_said(voice: Voice, tmp_path: Path) -> None:
    words = voice.text.replace("apples", "zorplix")
    request = SpeakRequest(voice.path, tmp_path / "take.json", words)
    done = speak(request)
    assert done.performance.warnings == ["How these words sound was guessed from their letters: zorplix."]
    nonsense = " ".join(["extraordinary electrification possibilities"] * 30)  # which cannot be said in this time
    done = speak(SpeakRequest(voice.path, tmp_path / "take.json", nonsense))
    assert done.performance.warnings == ["Parts of the text were not found in the recording; there, lips follow what is heard."]
    assert done.performance.weights[:, JAW].max() > 0.1


def test_the_command_writes_a_performance(voice: Voice, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, output = tmp_path / "said.txt", tmp_path / "take.json"
    text.write_text(voice.text, "utf-8-sig")
    assert main(["speak", str(voice.path), "-o", str(output), "--text-file", str(text), "--start", "0.5", "--end", "2.5"]) == 0
    found = format_to_read(output, "performance").read(output)
    assert (found.fps, found.frame_count) == (FPS, round(2.0 * FPS))
    assert found.head_rotation is not None
    assert found.weights.min() >= 0.0
    assert found.weights.max() <= 1.0
    capsys.readouterr()
    assert main(["speak", str(voice.path), "-o", str(output)]) == 0
    assert "Heard: maybe we should buy five more apples" in capsys.readouterr().out


def test_the_sound_of_a_video_is_taken_and_formats_are_alike(voice: Voice, tmp_path: Path) -> None:
    wave = write_sound(tmp_path / "two.wav", voice.samples, RATE, 48_000, 2)
    louder = loudness(read_sound(wave)) - loudness(voice.samples)  # by what a mixture of two channels is
    assert louder[20:-20].std() < 0.3
    video = write_video(tmp_path / "tone.mp4", [np.zeros((32, 32, 3), np.uint8)] * 15, sound=1.0)
    assert len(read_sound(video)) / RATE == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("kind", ["silence", "tone", "nothing"])
def test_nobody_speaks(kind: str, tmp_path: Path) -> None:
    times = np.arange(RATE) / RATE
    samples = {"silence": np.zeros(RATE), "tone": 8000.0 * np.sin(2.0 * np.pi * 440.0 * times), "nothing": np.zeros(160)}[kind]
    path = write_sound(tmp_path / "quiet.wav", samples.astype(np.int16), RATE, RATE, 1)
    with pytest.raises(GrmmError, match=r"Nobody is heard to speak in quiet\.wav"):
        speak(SpeakRequest(path, tmp_path / "take.json"))
    assert not (tmp_path / "take.json").exists()


def test_what_cannot_be_read_is_said_in_a_sentence(voice: Voice, tmp_path: Path) -> None:
    output = tmp_path / "take.json"
    (tmp_path / "text.wav").write_text("no sound")
    silent = write_video(tmp_path / "silent.mp4", [np.zeros((32, 32, 3), np.uint8)] * 5)
    for path, error, sentence in (
        (tmp_path / "none.wav", FileAccessError, "does not exist"),
        (tmp_path, FileAccessError, "is a folder"),
        (tmp_path / "text.wav", FileFormatError, "is not a readable recording"),
        (silent, FileFormatError, "has no sound"),
    ):
        with pytest.raises(error, match=sentence):
            speak(SpeakRequest(path, output))
    with pytest.raises(FileAccessError, match="begin before second 99"):
        speak(SpeakRequest(voice.path, output, start=99.0))
    with pytest.raises(FileAccessError, match="does not exist; make it"):
        speak(SpeakRequest(voice.path, tmp_path / "no" / "take.json"))
    with pytest.raises(CancelledError):
        speak(SpeakRequest(voice.path, output), cancelled=lambda: True)
    assert not output.exists()


def test_damaged_recordings_end_in_a_sentence_or_a_performance(voice: Voice, tmp_path: Path) -> None:
    whole, generator, path = voice.path.read_bytes(), np.random.default_rng(0), tmp_path / "damaged.ogg"
    outcomes = set()
    for _ in range(30):
        data = bytearray(whole[: generator.integers(1, len(whole) + 1)])
        for place in generator.integers(0, len(data), generator.integers(0, 20)):
            data[place] = generator.integers(256)
        path.write_bytes(bytes(data))
        try:
            outcomes.add(len(read_sound(path)) > 0)
        except (FileAccessError, FileFormatError):
            outcomes.add(False)
    assert outcomes == {True, False}


def test_requests_travel_whole_and_are_checked() -> None:
    request = SpeakRequest(
        Path("-ä.wav"), Path("ö.json"), "say “it” --now", strength=0.5, liveliness=2.0, seed=7, start=1.5, end=2.25
    )
    parsed = build_parser()[0].parse_args(["speak", *request.arguments()])
    assert SpeakRequest.from_arguments(parsed) == request
    for wrong in (
        {"language": "klingon"}, {"language": OTHER, "text": "hi"}, {"strength": 3.0}, {"liveliness": -1.0}, {"seed": -1},
        {"start": -1.0}, {"start": 2.0, "end": 1.0}, {"output": Path("take.txt")}, {"strength": float("nan")},
    ):  # fmt: skip
        with pytest.raises(ConfigError):
            SpeakRequest(**{"recording": Path("a.wav"), "output": Path("a.json"), **wrong})


def test_a_missing_library_is_said(voice: Voice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pocketsphinx", None)
    with pytest.raises(RuntimeMissingError, match="pip install pocketsphinx"):
        speak(SpeakRequest(voice.path, tmp_path / "take.json"))
