"""Avatars of a folder of people, one after another or on a cluster, for ``grmm fit FOLDER``."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..avatar import EXTENSION
from ..errors import CancelledError, ConfigError, GrmmError
from ..files.access import make_folder
from ..jobs.cluster import Cluster, run_pieces
from ..jobs.progress import Share
from .api import fit
from .request import FitRequest

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True)
class PersonFit:
    """What became of one person.

    Attributes:
        name: Of the photo without its suffix, or of the folder.
        file: The avatar; "" where there is none.
        error: Why there is none.
        seconds: That the fit took; 0 for an avatar that was there before.
        rmse: Root mean square color error in each photo's view.
    """

    name: str
    file: str = ""
    error: str = ""
    seconds: float = 0.0
    rmse: tuple[float, ...] = ()


def photos_in(folder: str | Path) -> list[Path]:
    """Photos of a folder by their suffix, sorted; empty where there are none."""
    path = Path(folder)
    return sorted(p for p in path.iterdir() if p.suffix.lower() in PHOTO_SUFFIXES) if path.is_dir() else []


def people_in(folder: Path) -> dict[str, tuple[Path, ...]]:
    """People of a folder by name: each photo shows one, and so do all photos of a folder in it.

    Raises:
        ConfigError: There is nobody, or two have one name.
    """
    found: list[tuple[str, tuple[Path, ...]]] = [(path.stem, (path,)) for path in photos_in(folder)]
    found += [(path.name, tuple(photos)) for path in sorted(folder.iterdir()) if (photos := photos_in(path))]
    people = dict(found)
    if not people:
        raise ConfigError(f"{folder} holds neither photos nor folders of photos; choose another folder.")
    if len(people) < len(found):
        twice = next(name for name, _ in found if sum(name == other for other, _ in found) > 1)
        raise ConfigError(f"Two people in {folder} are called {twice}; rename one, or put their photos into one folder.")
    return people


def fit_people(
    folder: Path, output: Path, request: FitRequest, report: Share, cluster: Cluster | None = None
) -> Iterator[PersonFit]:  # fmt: skip
    """Make an avatar of everybody in a folder; yields what became of each when it is known.

    Args:
        folder: Of the people, see `people_in`.
        output: Folder for NAME.grmm.
        request: How; photos, output and name are each person's. Where it asks to resume, avatars that are there are kept.
        report: Hears how much is done; ends it by `CancelledError`.
        cluster: Where the fits run; None for this process.

    Raises:
        GrmmError: As `people_in` and `run_pieces`; what is wrong with a photo is said of its person.
    """
    people = people_in(folder.absolute())
    make_folder(output)
    requests = [
        dataclasses.replace(request, photos=photos, output=output.absolute() / f"{name}{EXTENSION}", name=name)
        for name, photos in people.items()
    ]
    yield from (person for _, person in run_pieces(fit_person, requests, report, cluster))


def fit_person(request: FitRequest, report: Share) -> PersonFit:
    """Make one avatar, where it is not there already; what goes wrong with it is part of the answer."""
    name = request.output.stem
    if request.resume and request.output.exists():
        return PersonFit(name, str(request.output))
    try:
        result = fit(request, progress=lambda progress: report(progress.fraction, name))
    except CancelledError:
        raise
    except GrmmError as error:
        return PersonFit(name, error=str(error))
    return PersonFit(name, str(result.path), "", result.seconds, result.rmse)
