"""`python -m tools.voice_figures`: how well lips follow a voice, on synthetic voices whose phones are known.

The sentences below are spoken by flite's voices, which are made of recordings of real people (Debian's package `flite`;
`--flite` names another program), and listened to: with their text given, by words, and in single sounds. What is found moves
the lips of the mean head, and so does the truth; printed are the correlations of how far lips are open, wide and forward, how
many of the closures of P, B and M are made while they are heard, and the same for a jaw that follows the loudness. `--record`
writes the first sentence and its phones as the tests use them, `--sheet` draws the default avatar that says its beginning.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.fitting.point_rig import LandmarkRig
from grmm_core.geometry.camera import Camera
from grmm_core.head.head_model import JOINT_COUNT
from grmm_core.head.open_head import load_open_head
from grmm_core.pictures.images import quantize
from grmm_core.pictures.recordings import pyav
from grmm_core.session import Instance, RenderOptions, create_session
from grmm_core.voice.api import FPS, speak
from grmm_core.voice.listening import SILENCE, Phone, listen
from grmm_core.voice.mouth import mouth
from grmm_core.voice.request import SpeakRequest
from grmm_core.voice.sound import HOP, RATE, loudness, read_sound

from .people_pictures import PAPER, sheet

SENTENCES = (
    "Maybe we should buy five more apples before the shop closes.",
    "The old boat moved slowly past the harbor while people waved from the pier.",
    "She thought about the weather and put a warm blue coat over her shoulders.",
    "Who would have known that the movie was made in a village near the river?",
    "Pick up the paper, please, and show me how you folded it.",
    "Every morning he feeds the birds, waters the flowers and makes a pot of coffee.",
    "It would be better to move the piano before somebody bumps into it.",
    "Thick fog rolled over the valley, and nobody could see the bridge any more.",
)
VOICES = ("rms", "awb", "slt")
SIZE, SHOWN, COLUMNS, QUALITY, INK = 220, 16, 8, 85, (90, 90, 90)  # of the sheet: pixels of a picture, pictures
_NAMES = {"PAU": SILENCE, "AX": "AH", "BRTH": SILENCE}
_UPPER, _LOWER, _LEFT, _RIGHT, _MIDDLE = 13, 14, 61, 291, 0  # landmarks: inner lips, corners, the upper lip's middle
_LIPS = frozenset("PBM")
_JAW = 0.3  # jawOpen at the loudest, of a jaw that follows the loudness
_SHUT = 0.9  # of mouthClose's share of the jaw, from which lips are closed


def spoken(flite: str, voice: str, text: str, path: Path) -> list[Phone]:
    """Let a voice say a text into a file; its phones."""
    said = subprocess.run(
        [flite, "-voice", voice, "-psdur", "-t", text, "-o", str(path)], capture_output=True, text=True, check=True
    )
    phones, now = [], 0.0
    for token in said.stdout.split():
        name, end = token.upper().split(":")
        phones.append(Phone(_NAMES.get(name, name), now, float(end)))
        now = float(end)
    return phones


class Lips:
    """Where the lips of the mean head are."""

    def __init__(self) -> None:
        rig = LandmarkRig(load_open_head())
        self._person = rig.of_person(np.zeros(rig.shape_count), np.ones(len(ARKIT_NAMES)))

    def __call__(self, weights: np.ndarray) -> np.ndarray:
        """Millimetres open, wide and forward, [T, 3]."""
        still = np.zeros((JOINT_COUNT, 3))
        points = 1000.0 * np.stack([self._person.positions(np.zeros(0), row, still) for row in weights])
        apart = [np.linalg.norm(points[:, a] - points[:, b], axis=1) for a, b in ((_UPPER, _LOWER), (_LEFT, _RIGHT))]
        return np.stack([*apart, points[:, _MIDDLE, 2]], axis=1)


def followed(truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Correlations of the columns, [3]."""
    return np.array([np.corrcoef(a, b)[0, 1] for a, b in zip(truth.T, found.T, strict=True)])


def closures(phones: Sequence[Phone], weights: np.ndarray, times: np.ndarray) -> tuple[int, int]:
    """How many closures of lips are made while they are heard, and how many there are."""
    jaw, close = (weights[:, ARKIT_NAMES.index(name)] for name in ("jawOpen", "mouthClose"))
    shut = close >= _SHUT * jaw
    spans = [(phone.start, phone.end) for phone in phones if phone.name in _LIPS]
    return sum(bool((shut & (close > 0.0))[(times >= a) & (times <= b)].any()) for a, b in spans), len(spans)


def loud_jaw(levels: np.ndarray, times: np.ndarray) -> np.ndarray:
    """What is usual without recognition: the jaw opens with the loudness, [T, 52]."""
    weights = np.zeros((len(times), len(ARKIT_NAMES)))
    low, high = np.percentile(levels, 10), levels.max()
    heard = np.interp(times, np.arange(len(levels)) * HOP, levels)
    weights[:, ARKIT_NAMES.index("jawOpen")] = _JAW * np.clip((heard - low) / (high - low), 0.0, 1.0)
    return weights


def record(flite: str, folder: Path) -> None:
    """Write the tests' voice: Opus, and the phones as they truly are."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        wave = Path(made) / "voice.wav"
        phones = spoken(flite, VOICES[0], SENTENCES[0], wave)
        samples = read_sound(wave)
    av = pyav()
    with av.open(str(folder / "voice.ogg"), "w") as container:
        stream = container.add_stream("libopus", rate=RATE, layout="mono", bit_rate=24_000)
        frame = av.AudioFrame.from_ndarray(samples[None], format="s16", layout="mono")
        frame.sample_rate = RATE
        container.mux([*stream.encode(frame), *stream.encode()])
    document = {"text": SENTENCES[0], "phones": [[phone.name, phone.start, phone.end] for phone in phones]}
    (folder / "voice.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def draw(flite: str, path: Path) -> None:
    """Draw the middle of each of the first phones, with its name."""
    with tempfile.TemporaryDirectory() as made:
        wave = Path(made) / "voice.wav"
        phones = spoken(flite, VOICES[0], SENTENCES[0], wave)
        performance = speak(SpeakRequest(wave, Path(made) / "take.json", SENTENCES[0])).performance
    camera = Camera.orbit(SIZE, SIZE, yaw=12.0, pitch=0.0, distance=1.1, fov=12.5, target=(0.0, -0.015, 0.03))
    tiles = []
    with create_session("local") as session:
        avatar = session.open("default").id
        for phone in [phone for phone in phones if phone.name != SILENCE][:SHOWN]:
            frame = round((phone.start + phone.end) / 2 * performance.fps)
            picture = session.render(
                [Instance(avatar, performance.controls(frame, "neck"))], camera, RenderOptions(background=PAPER)
            )
            image = Image.fromarray(quantize(picture["rgb"]))
            ImageDraw.Draw(image).text((8, 6), phone.name, fill=INK, font_size=18)
            tiles.append(np.asarray(image))
    sheet(tiles, COLUMNS).save(path, quality=QUALITY)


def main(arguments: Sequence[str]) -> int:
    """Run; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--flite", default="flite", help="the program")
    parser.add_argument("--record", type=Path, metavar="FOLDER", help="write the tests' voice instead")
    parser.add_argument("--sheet", type=Path, metavar="FILE", help="draw the picture of docs/voice.md instead")
    args = parser.parse_args(arguments)
    if shutil.which(args.flite) is None:
        print(f"There is no program {args.flite}; install flite (on Debian: apt-get install flite).")
        return 1
    if args.record:
        record(args.flite, args.record)
        return 0
    if args.sheet:
        draw(args.flite, args.sheet)
        return 0
    lips = Lips()
    print("voice  way    open  wide  forward  closures  seconds of processor time a second")
    for voice in VOICES:
        sums: dict[str, list[np.ndarray]] = {}
        for text in SENTENCES:
            with tempfile.TemporaryDirectory() as made:
                wave = Path(made) / "voice.wav"
                phones = spoken(args.flite, voice, text, wave)
                samples = read_sound(wave)
            levels, times = loudness(samples), np.arange(round(len(samples) / RATE * FPS)) / FPS
            truth = lips(mouth(phones, levels, times))
            for way, options in {"text": (text, True), "words": ("", True), "sounds": ("", False)}.items():
                begin = time.process_time()
                heard = listen(samples, *options)
                took = time.process_time() - begin
                weights = mouth(heard.phones, levels, times)
                row = [*followed(truth, lips(weights)), *closures(phones, weights, times), took, len(samples) / RATE]
                sums.setdefault(way, []).append(np.array(row))
            jaw = loud_jaw(levels, times)
            sums.setdefault("loud", []).append(np.array([*followed(truth, lips(jaw)), *closures(phones, jaw, times), 0.0, 1.0]))
        for way, rows in sums.items():
            mean, total = np.mean(rows, 0), np.sum(rows, 0)
            print(
                f"{voice:6} {way:6} {mean[0]:.2f}  {mean[1]:.2f}  {mean[2]:.2f}     {total[3]:.0f} of {total[4]:.0f}  "
                f"{total[5] / total[6]:.2f}"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
