"""Which phones are heard when, by PocketSphinx and the English models that come with it.

A recording is cut into utterances where nobody speaks. English ones are heard as words, and the words' phones are then
aligned with the sound: the dictionary's idea of a word is right more often than what single sounds seem to be. With the text
given, only the alignment is left to do. Other languages are heard as single sounds, the nearest that English has. Needs
pocketsphinx.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import SequenceMatcher
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RuntimeMissingError
from ..jobs.progress import Share, nobody
from .sound import HOP, RATE, loudness
from .spelling import spelled_sounds, words_of

SILENCE = "SIL"
_FRAMES = 100  # of the recogniser, a second
_NOISES = {"+NSN+": SILENCE, "+SPN+": SILENCE, "<sil>": SILENCE, "<s>": SILENCE, "</s>": SILENCE}  # breath, coughs
_PAUSE = 0.35  # seconds without speech that end an utterance
_LEAD = 0.2  # seconds of what is around it that an utterance keeps
_LONGEST = 20.0  # seconds of an utterance: recognition gets slow and forgets its beginning
_SHORTEST = 0.1
# Of the search in single sounds: wide beams, since there are few of them, and half of the usual trust in their usual order.
_SOUND_BEAM, _SOUND_TRUST = 1e-20, 2.0


@dataclass(frozen=True)
class Phone:
    """One sound of speech.

    Attributes:
        name: In ARPAbet, without stress, or `SILENCE`.
        start: Second at which it begins.
        end: Second at which it ends.
    """

    name: str
    start: float
    end: float


@dataclass(frozen=True)
class Heard:
    """What is said in a recording.

    Attributes:
        phones: In time, without gaps, from the beginning to the end; pauses are `SILENCE`.
        text: The words that were heard or given; "" where only sounds were heard.
        unknown: Words that are in no dictionary; their sounds were guessed.
        unplaced: Whether parts of a given text were not found in the sound.
    """

    phones: tuple[Phone, ...]
    text: str = ""
    unknown: tuple[str, ...] = ()
    unplaced: bool = False


def pocketsphinx() -> Any:
    """The library. Raises `RuntimeMissingError` where it is not installed."""
    try:
        import pocketsphinx
    except ImportError as error:
        raise RuntimeMissingError(
            "Performances from voices need PocketSphinx; run pip install pocketsphinx, or install Blender's runtime again."
        ) from error
    return pocketsphinx


def listen(samples: np.ndarray, text: str = "", english: bool = True, progress: Share = nobody) -> Heard:
    """Find the phones of a recording.

    Args:
        samples: At `sound.RATE`, [N] int16.
        text: What is said, or "".
        english: Whether words are listened for.
        progress: Hears the share done; may raise to cancel.

    Raises:
        RuntimeMissingError: PocketSphinx is not installed.
    """
    spans = utterances(samples)
    parts = [samples[round(begin * RATE) : round(end * RATE)].tobytes() for begin, end in spans]
    hear = _Words() if english else _Sounds()
    given = words_of(text)
    found: list[list[Phone]] = []
    said: list[str] = []
    heard: list[list[str]] = []
    if english and given and len(spans) > 1:  # which of these words belong to which utterance
        for index, part in enumerate(parts):
            progress(0.5 * index / len(parts))
            heard.append(hear.words(part))
        shares = _shared_out(given, heard)
    else:
        shares = [given] * len(parts)
    missed = False
    for index, ((begin, _), part) in enumerate(zip(spans, parts, strict=True)):
        progress((0.5 + 0.5 * index / len(parts)) if heard else index / len(parts))
        words, phones = hear(part, shares[index])
        missed |= bool(shares[index]) and words != shares[index]
        said += words
        found.append([Phone(phone.name, phone.start + begin, phone.end + begin) for phone in phones])
    progress(1.0)
    return Heard(_without_gaps(found, len(samples) / RATE), " ".join(said), tuple(sorted(hear.unknown)), missed)


def utterances(samples: np.ndarray) -> list[tuple[float, float]]:
    """Begin and end in seconds of what is spoken without a pause, each with a little of the silence around it."""
    vad = pocketsphinx().Vad(2, RATE)
    data, step = samples.tobytes(), vad.frame_bytes
    flags = np.array([vad.is_speech(data[i : i + step]) for i in range(0, len(data) - step + 1, step)], bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))).reshape(-1, 2) * vad.frame_length
    length = len(samples) / RATE
    joined: list[list[float]] = []
    for begin, end in edges.tolist():
        if joined and (begin - joined[-1][1] < _PAUSE):
            joined[-1][1] = end
        else:
            joined.append([begin, end])
    result: list[tuple[float, float]] = []
    for index, (begin, end) in enumerate(joined):
        if end - begin < _SHORTEST:
            continue
        first = (joined[index - 1][1] + begin) / 2 if index else 0.0  # nothing is heard twice
        last = (end + joined[index + 1][0]) / 2 if index + 1 < len(joined) else length
        low, high = max(begin - _LEAD, first), min(end + _LEAD, last)
        pieces = max(1, int(np.ceil((high - low) / _LONGEST)))
        cuts = [low, *(_quiet(samples, low + (high - low) * i / pieces) for i in range(1, pieces)), high]
        result += list(pairwise(cuts))
    return result


def _quiet(samples: np.ndarray, around: float, reach: float = 2.0) -> float:
    """The quietest moment within some seconds of one."""
    begin = max(round((around - reach) * RATE), 0)
    levels = loudness(samples[begin : round((around + reach) * RATE)])
    smooth = np.convolve(levels, np.ones(9) / 9, "same")
    return begin / RATE + HOP * (4 + int(np.argmin(smooth[4:-4])))


def _shared_out(given: list[str], heard: list[list[str]]) -> list[list[str]]:
    """Cut a text into what belongs to each utterance, by the words that were heard in these."""
    flat = [word for words in heard for word in words]
    matched = SequenceMatcher(None, flat, given, autojunk=False).get_matching_blocks()
    # Place in the text of each place in what was heard: exact in equal runs, in proportion between them.
    known = [(0, 0)] + [(b.a + i, b.b + i) for b in matched for i in (0, b.size) if b.size] + [(len(flat), len(given))]
    places = np.round(np.interp(np.arange(len(flat) + 1), *np.array(known, float).T)).astype(int)
    cuts = places[np.concatenate([[0], np.cumsum([len(words) for words in heard])])]
    cuts[-1] = len(given)
    return [given[begin:end] for begin, end in pairwise(cuts)]


class _Words:
    """Hears words, and aligns their phones."""

    def __init__(self) -> None:
        library = pocketsphinx()
        self._new_recogniser: Callable[[], Any] = lambda: library.Decoder(samprate=RATE, loglevel="FATAL")
        self._recogniser: Any = None  # its language model takes half a second to read
        self._aligner = library.Decoder(lm=None, samprate=RATE, loglevel="FATAL", bestpath=False)
        self._sounds: _Sounds | None = None
        self.unknown: set[str] = set()

    def words(self, part: bytes) -> list[str]:
        """The words of an utterance."""
        if self._recogniser is None:
            self._recogniser = self._new_recogniser()
        _run(self._recogniser, part)
        hypothesis = self._recogniser.hyp()
        return [] if hypothesis is None else words_of(hypothesis.hypstr)

    def __call__(self, part: bytes, given: list[str]) -> tuple[list[str], list[Phone]]:
        """Words and phones of an utterance; what does not fit the words is heard as sounds."""
        words = given or self.words(part)
        for word in words:
            if self._aligner.lookup_word(word) is None:
                self.unknown.add(word)
                self._aligner.add_word(word, " ".join(spelled_sounds(word)), True)
        phones = self._aligned(part, words) if words else []
        if phones:
            return words, phones
        self._sounds = self._sounds or _Sounds()
        return [], self._sounds(part, [])[1]

    def _aligned(self, part: bytes, words: list[str]) -> list[Phone]:
        aligner = self._aligner
        try:
            aligner.set_align_text(" ".join(words))
            _run(aligner, part)
            aligner.set_alignment()  # of these words' phones
            _run(aligner, part)
            found = aligner.get_alignment()
        except RuntimeError:  # no path through the words ends with the sound
            return []
        return [] if found is None else [_phone(each.name, each.start, each.duration) for word in found for each in word]


class _Sounds:
    """Hears single sounds."""

    def __init__(self) -> None:
        library = pocketsphinx()
        model = Path(library.get_model_path()) / "en-us" / "en-us-phone.lm.bin"
        self._recogniser = library.Decoder(
            allphone=str(model), lm=None, dict=None, samprate=RATE, loglevel="FATAL", lw=_SOUND_TRUST, beam=_SOUND_BEAM,
            pbeam=_SOUND_BEAM,
        )  # fmt: skip
        self.unknown: set[str] = set()

    def words(self, part: bytes) -> list[str]:
        """None."""
        return []

    def __call__(self, part: bytes, given: list[str]) -> tuple[list[str], list[Phone]]:
        """No words, and the phones of an utterance."""
        _run(self._recogniser, part)
        segments = self._recogniser.seg() or ()
        return [], [_phone(each.word, each.start_frame, each.end_frame - each.start_frame + 1) for each in segments]


def _run(decoder: Any, part: bytes) -> None:
    decoder.start_utt()
    decoder.process_raw(part, full_utt=True)
    decoder.end_utt()


def _phone(name: str, start: int, duration: int) -> Phone:
    return Phone(_NOISES.get(name, name), start / _FRAMES, (start + duration) / _FRAMES)


def _without_gaps(found: list[list[Phone]], length: float) -> tuple[Phone, ...]:
    """Phones of all utterances with silence between them."""
    result: list[Phone] = []
    now = 0.0
    for phone in (phone for phones in found for phone in phones):
        start, end = max(phone.start, now), min(phone.end, length)
        if end <= start:
            continue
        if start > now:
            result.append(Phone(SILENCE, now, start))
        result.append(Phone(phone.name, start, end))
        now = end
    if length > now:
        result.append(Phone(SILENCE, now, length))
    return tuple(result)
