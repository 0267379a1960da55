"""Capture data sets as training views. Used by the command line and the evaluation."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageFilter

from ..data.dataset import CaptureDataset
from ..data.layers import PART_LAYER, PARTS
from ..data.types import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, TRAIN, Shot
from ..data.types import View as CapturedView
from ..errors import ConfigError, FileFormatError, TrainingError
from .views import View

if TYPE_CHECKING:
    from ..head import HeadModel

CACHE_BYTES = 6 << 30
_DETAILS = ("eyes", "teeth", "mouth")
VALIDATION_SPLITS = (HELD_OUT_EXPRESSION, HELD_OUT_CAMERA)


class CapturedViews:
    """A `ViewSource` over one or several capture folders; decoded pictures are kept in memory up to a limit.

    Args:
        datasets: Opened folders of one head model; people are named FOLDER/NAME where there are several, with as much of the
            path as tells the folders apart.
        follow: The captures are still running: count everybody whom they will show, and find new shots at `refresh`.
        cache_bytes: Limit of the memory for pictures.
        only: The one person whose views are used, by name; everybody when empty.
        bare: Show people without hair, where the data can; views that only show a bare head are left out otherwise.
        detail: Also say where eyes, teeth and inner mouth are, where the data has part masks.

    Attributes:
        datasets: As given.

    Raises:
        ConfigError: A folder is given twice.
        FileFormatError: People have shapes of different lengths.
        TrainingError: No view to train on.
    """

    def __init__(
        self, datasets: Sequence[CaptureDataset], follow: bool = False, cache_bytes: int = CACHE_BYTES, only: str = "",
        bare: bool = False, detail: bool = False,
    ) -> None:  # fmt: skip
        self._bare, self._detail = bare, detail
        self.datasets = tuple(datasets)
        self._items: list[tuple[int, CaptureDataset, Shot, CapturedView]] = []
        self._seen: set[tuple[int, str, int]] = set()
        self._cache: OrderedDict[int, View] = OrderedDict()
        self._room = cache_bytes
        self._numbers: dict[tuple[int, str], int] = {}
        names: list[str] = []
        labels = _labels([dataset.folder for dataset in self.datasets])
        for place, dataset in enumerate(self.datasets):
            trained = {shot.subject for shot, _ in dataset.views(TRAIN)}
            everybody = dataset.manifest.subjects if follow else dataset.subjects
            for name in everybody:
                if only and name != only:
                    continue
                if name not in dataset.manifest.held_out_people and (follow or name in trained):
                    self._numbers[place, name] = 0 if only else len(names)
                    names.append(name if only or len(datasets) == 1 else f"{labels[place]}/{name}")
        self.people = tuple(dict.fromkeys(names))  # one person's views may lie in several folders
        self.shapes = np.zeros((0, 0), np.float32)
        self._collect()
        if not len(self.training):
            raise TrainingError("The data holds no training views; capture more or wait until a person is complete.")

    def refresh(self) -> int:
        """Look for shots that were added; returns the number of views known. Numbers of known views stay."""
        for dataset in self.datasets:
            dataset.refresh()
        self._collect()
        return len(self._items)

    def _collect(self) -> None:
        shapes: list[np.ndarray | None] = [None] * len(self.people)
        size, first = 0, ""
        for place, dataset in enumerate(self.datasets):
            for shot in dataset.shots:
                number, key = self._numbers.get((place, shot.subject)), (place, shot.subject, shot.number)
                if number is not None and key not in self._seen:
                    self._seen.add(key)
                    self._items += [(number, dataset, shot, view) for view in shot.shown(self._bare)]
            for name in dataset.subjects:
                number = self._numbers.get((place, name))
                if number is None:
                    continue
                shape = shapes[number] = dataset.shape(name)
                size, first = size or len(shape), first or name
                if len(shape) != size:
                    raise FileFormatError(
                        f"{dataset.folder}: {name} has {len(shape)} shape coefficients and {first} has {size}; "
                        "capture the person again."
                    )
        rows = [np.zeros(size, np.float32) if shape is None else shape for shape in shapes]  # not captured yet
        self.shapes = np.stack(rows).astype(np.float32) if rows else np.zeros((0, size), np.float32)
        self.subjects = np.array([number for number, _, _, _ in self._items], np.int64)
        splits = np.array([view.split for _, _, _, view in self._items])
        self.training = np.flatnonzero(splits == TRAIN)
        self.validation = np.flatnonzero(np.isin(splits, VALIDATION_SPLITS))

    def load(self, index: int) -> View:
        """Return a view. Raises `FileFormatError` or `FileAccessError` naming the picture that cannot be used."""
        cached = self._cache.get(index)
        if cached is not None:
            self._cache.move_to_end(index)
            return cached
        person, dataset, shot, view = self._items[index]
        picture = dataset.picture(shot, view)
        mask = np.round(picture.mask * 255.0).astype(np.uint8)
        image = np.round(picture.over(0.0) * 255.0).astype(np.uint8)
        name = f"{shot.subject} {shot.number} {view.name}"
        loaded = View(
            person,
            name,
            view.camera,
            image,
            mask,
            picture.depth,
            shot.aligned,
            shot.expression,
            shot.pose,
            view.split,
            shot.displacement,
            detail=self._details(dataset, shot, view) if self._detail else None,
        )
        self._keep(index, loaded)
        return loaded

    @staticmethod
    def _details(dataset: CaptureDataset, shot: Shot, view: CapturedView) -> np.ndarray | None:
        """`View.detail`; grown by a fiftieth of the picture, so that lids and lips' edges belong to it."""
        if PART_LAYER not in view.layers:
            return None
        parts = dataset.layer(shot, view, PART_LAYER)[[PARTS.index(name) for name in _DETAILS]].sum(0)
        covered = Image.fromarray(np.round(parts.clip(0, 1) * 255.0).astype(np.uint8))
        return np.asarray(covered.filter(ImageFilter.MaxFilter(max(covered.size) // 100 * 2 + 1)))

    def _keep(self, index: int, view: View) -> None:
        self._cache[index] = view
        self._room -= _size(view)
        while self._room < 0 and len(self._cache) > 1:
            self._room += _size(self._cache.popitem(last=False)[1])


def capture_views(
    folders: Sequence[str | os.PathLike[str]],
    follow: bool = False,
    head: HeadModel | None = None,
    only: str = "",
    bare: bool = False,
    detail: bool = False,
) -> tuple[CapturedViews, HeadModel]:
    """Open data folders of any known format, and the head model that they were made with.

    Args:
        folders: Data folders, see `data.readers`.
        follow: See `CapturedViews`.
        head: The user's FLAME for data with FLAME parameters; the open head when None.
        only: See `CapturedViews`.
        bare: See `CapturedViews`.
        detail: See `CapturedViews`.

    Raises:
        FileAccessError, FileFormatError: A folder is missing or not a capture.
        ConfigError: The folders belong to different head models, or to another one than `head`, or one is given twice.
        TrainingError: No view to train on.
    """
    from ..data.readers import open_dataset
    from ..head import load_open_head

    datasets = [open_dataset(folder, head) for folder in folders]
    head = load_open_head() if head is None else head
    for dataset in datasets:
        if dataset.manifest.head != head.name:
            raise ConfigError(f"{dataset.folder} was made with the head model {dataset.manifest.head!r}, not {head.name!r}.")
    return CapturedViews(datasets, follow, only=only, bare=bare, detail=detail), head


def _labels(folders: Sequence[Path]) -> list[str]:
    """The shortest ends of paths that tell folders apart, of equally many names; the last name alone where that will do."""
    absolute = [folder.absolute() for folder in folders]
    resolved = [folder.resolve() for folder in folders]
    for folder, place in zip(folders, resolved, strict=True):
        if resolved.count(place) > 1:
            raise ConfigError(f"The data folder {folder} is given twice; give every folder once.")
    labels = [path.name for path in absolute]
    for count in range(1, max((len(path.parts) for path in absolute), default=0) + 1):
        labels = ["/".join(path.parts[-count:]) for path in absolute]
        if len(set(labels)) == len(labels):
            break
    return labels


def _size(view: View) -> int:
    return sum(array.nbytes for array in (view.image, view.mask, view.depth, view.detail) if array is not None)
