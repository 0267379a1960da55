"""What is asked of a fit, and of the search for faces that comes before it: one record each, checked in one place.

The command line and Blender's panel make a `FitRequest`; it travels whole, as arguments of ``grmm fit`` through the job's
process or as JSON in the work folder, to `api.fit`. Needs the standard library only.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..avatar import EXTENSION
from ..errors import ConfigError, FileAccessError
from .presets import preset_named

MAX_PHOTOS = 16
WORK_SUFFIX = ".fit"
DEVICES = ("auto", "cpu", "cuda", "mps")


@dataclass(frozen=True)
class FitRequest:
    """An avatar of the person in one or several photos, who must have agreed. Paths may be given as text, several as a list.

    Attributes:
        photos: Files, the one whose light the avatar shall have first.
        output: `.grmm` file to write.
        preset: "fast", "standard" or "high".
        faces: Which face of each photo, counted from 0, the largest first; one for all photos, or none for the largest.
        masks: Pictures of the person's outline (white on black), one for each photo, in its order; empty finds the outline.
        weights: Name of installed weights, or a file; "" for the embedded ones.
        head: Head file for weights of another head model than the open one, or "".
        device: "auto", "cpu", "cuda" or "mps".
        threads: CPU threads; 0 leaves it to the libraries.
        work: Folder for the state; None is a folder beside the output, which is removed when the avatar is written.
        resume: Go on from the state in the work folder, if it is of the same photos; otherwise it is overwritten.
        name: Display name of the avatar; the output's file name when empty.

    Raises:
        ConfigError: These values cannot be meant. Files are looked at by `check_output` and when the fit begins.
    """

    photos: tuple[Path, ...]
    output: Path
    preset: str = "standard"
    faces: tuple[int, ...] = ()
    masks: tuple[Path, ...] = ()
    weights: str = ""
    head: str = ""
    device: str = "auto"
    threads: int = 0
    work: Path | None = None
    resume: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        _set_choice(self)
        _set(self, output=Path(self.output), work=None if self.work is None else Path(self.work))
        _set(self, weights=os.fspath(self.weights or ""), head=os.fspath(self.head or ""))
        preset_named(self.preset)
        if self.device not in DEVICES:
            raise ConfigError(f"There is no device {self.device!r}; use {', '.join(DEVICES)}.")
        if self.threads < 0:
            raise ConfigError(f"{self.threads} threads are not possible; use 1 or more, or 0 for all.")
        if self.output.suffix != EXTENSION:
            raise ConfigError(f"{self.output.name} does not end in {EXTENSION}; name the avatar's file NAME{EXTENSION}.")

    @property
    def work_folder(self) -> Path:
        """Folder of the state that a resume goes on from: `work`, else the one beside the output."""
        return self.work if self.work is not None else work_folder(self.output)

    def check_output(self) -> None:
        """Refuse an output that cannot become a file, before minutes are spent. Raises `FileAccessError`."""
        if not self.output.parent.is_dir():
            raise FileAccessError(f"The folder {self.output.parent} does not exist; make it or choose another one.")
        if self.output.is_dir():
            raise FileAccessError(f"{self.output} is a folder; give a file name.")

    def arguments(self) -> list[str]:
        """Arguments of ``grmm fit`` that ask for this."""
        result = [f"--{option}={getattr(self, option)}" for option in ("output", "preset", "device")]
        for option in ("weights", "head", "threads", "work", "name"):
            value = getattr(self, option)
            result += [f"--{option}={value}"] if value else []
        result += ["--resume"] if self.resume else []
        return [*result, *_choice_arguments(self)]

    @staticmethod
    def from_arguments(parsed: argparse.Namespace) -> FitRequest:
        """What parsed arguments of ``grmm fit`` ask for. Raises `ConfigError`."""
        if parsed.output is None:
            raise ConfigError(f"No avatar file is named; add -o NAME{EXTENSION}.")
        same: dict[str, Any] = {
            name: getattr(parsed, name) for name in ("output", "preset", "device", "work", "resume", "name")
        }
        optional: dict[str, Any] = {name: getattr(parsed, name) or "" for name in ("weights", "head")}
        return FitRequest(**_parsed_choice(parsed), **same, **optional, threads=parsed.threads or 0)

    def to_json(self) -> dict[str, Any]:
        """The request as JSON values, paths as text; `from_json` reads them."""
        values = dataclasses.asdict(self) | {"output": str(self.output), "work": None if self.work is None else str(self.work)}
        return values | {name: [str(path) for path in values[name]] for name in ("photos", "masks")} | {"faces": [*self.faces]}

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> FitRequest:
        """Read what `to_json` gave. Raises `ConfigError` where it is something else."""
        try:
            return FitRequest(**values)
        except (TypeError, ValueError, AttributeError) as error:
            raise ConfigError("This is no request for a fit of this version; ask for the fit again.") from error


@dataclass(frozen=True)
class FacesRequest:
    """Pictures of what is found in photos (faces, landmarks, outline), to check the choice before a fit.

    Attributes:
        photos, faces, masks: As in `FitRequest`.
        folder: Where the pictures go.
    """

    photos: tuple[Path, ...]
    folder: Path
    faces: tuple[int, ...] = ()
    masks: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        _set_choice(self)
        _set(self, folder=Path(self.folder))

    def arguments(self) -> list[str]:
        """Arguments of ``grmm fit`` that ask for this."""
        return [f"--find-faces={self.folder}", *_choice_arguments(self)]

    @staticmethod
    def from_arguments(parsed: argparse.Namespace) -> FacesRequest:
        """What parsed arguments of ``grmm fit --find-faces`` ask for. Raises `ConfigError`."""
        return FacesRequest(folder=parsed.find_faces, **_parsed_choice(parsed))


def work_folder(output: Path) -> Path:
    """Where the state of an avatar's file is kept, where no other folder is named."""
    return output.with_name(output.name + WORK_SUFFIX)


def faces_by_photo(request: FitRequest | FacesRequest) -> tuple[int, ...]:
    """Which face of each photo is meant, counted from 0."""
    return request.faces if len(request.faces) > 1 else (request.faces or (0,)) * len(request.photos)


def _set(request: FitRequest | FacesRequest, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(request, name, value)


def _set_choice(request: FitRequest | FacesRequest) -> None:
    """Check the choice of photos, faces and outlines. Raises `ConfigError`."""
    photos, masks = (tuple(Path(path) for path in paths) for paths in (request.photos, request.masks))
    faces = tuple(int(face) for face in request.faces)
    if not photos:
        raise ConfigError("No photo was given; choose at least one.")
    if len(photos) > MAX_PHOTOS:
        raise ConfigError(f"{len(photos)} photos were given; use at most {MAX_PHOTOS}.")
    if masks and len(masks) != len(photos):
        raise ConfigError(f"{len(masks)} masks were given for {len(photos)} photos; give one for each, or none.")
    if len(faces) not in (0, 1, len(photos)):
        raise ConfigError(f"{len(faces)} faces were chosen for {len(photos)} photos; choose one for each, or one for all.")
    if any(face < 0 for face in faces):
        raise ConfigError(f"There is no face {min(faces) + 1}; the largest is 1.")
    _set(request, photos=photos, masks=masks, faces=faces)


def _choice_arguments(request: FitRequest | FacesRequest) -> list[str]:
    faces = [f"--face={face + 1}" for face in request.faces]
    return [*faces, *(f"--mask={mask}" for mask in request.masks), "--", *map(str, request.photos)]


def _parsed_choice(parsed: argparse.Namespace) -> dict[str, Any]:
    return {"photos": parsed.photos, "faces": [face - 1 for face in parsed.faces], "masks": parsed.masks}
