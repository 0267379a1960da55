"""Sounds of English words that the dictionary lacks (names, mostly), by their letters. Needs the standard library only.

Rough on purpose: alignment hears when they are said, and lips need no more than the kind of sound. Longer spellings go first.
"""

from __future__ import annotations

import re

_SOUNDS = {
    spelling: tuple(sounds.split())
    for spelling, sounds in {
        "tion": "SH AH N", "sion": "ZH AH N", "ough": "OW", "augh": "AO", "eigh": "EY", "tch": "CH", "sch": "SH", "igh": "AY",
        "ch": "CH", "sh": "SH", "th": "TH", "ph": "F", "wh": "W", "gh": "G", "ck": "K", "ng": "NG", "qu": "K W", "kn": "N",
        "wr": "R", "ee": "IY", "ea": "IY", "ie": "IY", "ei": "EY", "ey": "IY", "ai": "EY", "ay": "EY", "oo": "UW", "ou": "AW",
        "ow": "OW", "oa": "OW", "oi": "OY", "oy": "OY", "au": "AO", "aw": "AO", "ew": "UW", "ue": "UW", "er": "ER", "ir": "ER",
        "ur": "ER", "ar": "AA R", "or": "AO R", "ce": "S EH", "ci": "S IH", "cy": "S IY",
        "a": "AE", "b": "B", "c": "K", "d": "D", "e": "EH", "f": "F", "g": "G", "h": "HH", "i": "IH", "j": "JH", "k": "K",
        "l": "L", "m": "M", "n": "N", "o": "OW", "p": "P", "q": "K", "r": "R", "s": "S", "t": "T", "u": "AH", "v": "V",
        "w": "W", "x": "K S", "y": "IY", "z": "Z",
    }.items()
}  # fmt: skip
_LONGEST = max(map(len, _SOUNDS))
_VOWELS = "aeiouy"
_WORD = re.compile(r"[a-z]+(?:'[a-z]+)*")


def words_of(text: str) -> list[str]:
    """The words of a text in small letters; what is not spelled in Latin letters is left out."""
    plain = text.lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'")  # noqa: RUF100
    return _WORD.findall(plain)


def spelled_sounds(word: str) -> tuple[str, ...]:
    """ARPAbet phones of a word in small letters, at least one."""
    letters = re.sub(r"[^a-z]", "", word)
    if len(letters) > 2 and letters[-1] == "e" and letters[-2] not in _VOWELS:  # silent
        letters = letters[:-1]
    letters = re.sub(r"([^aeiou])\1", r"\1", letters)  # a doubled consonant is one sound
    sounds: list[str] = []
    place = 0
    while place < len(letters):
        for length in range(min(_LONGEST, len(letters) - place), 0, -1):
            if (found := _SOUNDS.get(letters[place : place + length])) is not None:
                sounds += found
                place += length
                break
    return tuple(sounds) or ("AH",)
