"""Capture data sets as training views. Used by the command line and the evaluation."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..data.dataset import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, TRAIN, CaptureDataset, Shot
from ..data.dataset import View as CapturedView
from ..errors import ConfigError, TrainingError
from .views import View

if TYPE_CHECKING:
    from ..head import HeadModel

CACHE_BYTES = 6 << 30
VALIDATION_SPLITS = (HELD_OUT_EXPRESSION, HELD_OUT_CAMERA)


class CapturedViews:
    """A `ViewSource` over one or several capture folders; decoded pictures are kept in memory up to a limit.

    Args:
        datasets: Opened folders of one head model; people are named FOLDER/NAME where there are several.
        cache_bytes: Limit of the memory for pictures.

    Raises:
        TrainingError: No view to train on.
    """

    def __init__(self, datasets: Sequence[CaptureDataset], cache_bytes: int = CACHE_BYTES) -> None:
        self._items: list[tuple[int, CaptureDataset, Shot, CapturedView]] = []
        self._cache: OrderedDict[int, View] = OrderedDict()
        self._room = cache_bytes
        people: list[str] = []
        shapes: list[np.ndarray] = []
        for dataset in datasets:
            trained = {shot.subject for shot, _ in dataset.views(TRAIN)}
            numbers = {}
            for name in dataset.subjects:
                if name in trained:
                    numbers[name] = len(people)
                    people.append(name if len(datasets) == 1 else f"{dataset.folder.name}/{name}")
                    shapes.append(dataset.shape(name))
            self._items += [
                (numbers[shot.subject], dataset, shot, view) for shot, view in dataset.views() if shot.subject in numbers
            ]
        if not people:
            raise TrainingError("The data holds no training views; capture more or wait until a person is complete.")
        self.people = tuple(people)
        self.shapes = np.stack(shapes).astype(np.float32)
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
            person, name, view.camera, image, mask, picture.depth, shot.aligned, shot.expression, shot.pose, view.split
        )
        self._keep(index, loaded)
        return loaded

    def _keep(self, index: int, view: View) -> None:
        self._cache[index] = view
        self._room -= _size(view)
        while self._room < 0 and len(self._cache) > 1:
            self._room += _size(self._cache.popitem(last=False)[1])


def capture_views(folders: Sequence[str | os.PathLike[str]]) -> tuple[CapturedViews, HeadModel]:
    """Open capture folders and the head model that they were made with.

    Raises:
        FileAccessError, FileFormatError: A folder is missing or not a capture.
        ConfigError: The folders belong to different head models, or to one that is not the open head.
        TrainingError: No view to train on.
    """
    from ..head import load_open_head

    datasets = [CaptureDataset(os.fspath(folder)) for folder in folders]
    head = load_open_head()
    for dataset in datasets:
        if dataset.manifest.head != head.name:
            raise ConfigError(f"{dataset.folder} was made with the head model {dataset.manifest.head!r}, not {head.name!r}.")
    return CapturedViews(datasets), head


def _size(view: View) -> int:
    return view.image.nbytes + view.mask.nbytes + (0 if view.depth is None else view.depth.nbytes)
