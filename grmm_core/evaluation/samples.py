"""Which views of captures a protocol uses, and how they are loaded. Needs numpy; Pillow where pictures are touched."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..data.dataset import CaptureDataset
from ..data.layers import PART_LAYER, PARTS
from ..data.types import Shot, View
from ..errors import ConfigError
from ..geometry.camera import Camera

FRONT_DEGREES, BACK_DEGREES = 60.0, 120.0
CLOSE_UP_MM = 300.0  # that the picture's shorter side spans at the distance of the head: a whole head needs more
NEUTRAL_NORM = 1e-6


@dataclass(frozen=True)
class Sample:
    """One captured view.

    Attributes:
        dataset, shot, view: Where it is.
    """

    dataset: CaptureDataset
    shot: Shot
    view: View

    @property
    def name(self) -> str:
        """For messages and tables."""
        return f"{self.shot.subject} {self.shot.number} {self.view.name}"

    @property
    def yaw(self) -> float:
        """Direction of the camera around the head in degrees, 0 in front, positive to the subject's left, -180..180."""
        x, _, z = self.view.camera.view_direction(np.zeros(3))
        return math.degrees(math.atan2(x, z))

    @property
    def direction(self) -> str:
        """Front, side or back."""
        turn = abs(self.yaw)
        return "front" if turn < FRONT_DEGREES else "side" if turn < BACK_DEGREES else "back"

    @property
    def close(self) -> bool:
        """Whether the picture shows the face only."""
        return shown_mm(self.view.camera) < CLOSE_UP_MM

    @property
    def neutral(self) -> bool:
        """Whether no expression is performed."""
        return float(np.abs(self.shot.aligned).max(initial=0.0)) < NEUTRAL_NORM

    def parts(self, size: int = 0) -> np.ndarray | None:
        """Cover of each of `data.layers.PARTS`, 0..1 [P, H, W] float32, reduced as `load` does; None where no layer says."""
        if PART_LAYER not in self.view.layers:
            return None
        cover: np.ndarray = self.dataset.layer(self.shot, self.view, PART_LAYER)
        step = max(1, round(max(cover.shape[1:]) / size)) if size else 1
        rows, columns = (count // step * step for count in cover.shape[1:])
        blocks = cover[:, :rows, :columns].reshape(len(cover), rows // step, step, columns // step, step)
        return blocks.mean((2, 4)).astype(np.float32)

    def hair(self, size: int = 0) -> np.ndarray | None:
        """Cover of scalp hair, as `parts`, [H, W]."""
        parts = self.parts(size)
        return None if parts is None else parts[PARTS.index("hair")]


@dataclass(frozen=True)
class LoadedView:
    """A decoded view, reduced to the size asked for.

    Attributes:
        camera: In head space.
        image: Display sRGB over black, 0..1, [H, W, 3] float32.
        mask: Coverage 0..1, [H, W] float32.
        depth: Metres, 0 where empty, [H, W], or None.
    """

    camera: Camera
    image: np.ndarray
    mask: np.ndarray
    depth: np.ndarray | None


def shown_mm(camera: Camera) -> float:
    """Millimetres that the picture's shorter side spans at the distance of the head."""
    distance = float(np.linalg.norm(camera.position))
    return 1e3 * min(camera.width / camera.fx, camera.height / camera.fy) * (1.0 if camera.orthographic else distance)


def load(sample: Sample, size: int = 0) -> LoadedView:
    """Decode a view.

    Args:
        sample: Which.
        size: Longer side in pixels to which whole blocks of pixels are averaged; 0 keeps the view.

    Raises:
        FileAccessError, FileFormatError: The picture is missing or damaged; it is named.
    """
    from ..training.views import View as TrainingView
    from ..training.views import shrink

    picture = sample.dataset.picture(sample.shot, sample.view)
    shot = sample.shot
    image, mask = (np.round(array * 255.0).astype(np.uint8) for array in (picture.over(0.0), picture.mask))
    whole = TrainingView(
        0, sample.name, sample.view.camera, image, mask, picture.depth, shot.aligned, shot.expression, shot.pose
    )
    small = shrink(whole, size) if size else whole
    return LoadedView(small.camera, small.image.astype(np.float32) / 255.0, small.mask.astype(np.float32) / 255.0, small.depth)


def samples(datasets: Iterable[CaptureDataset], *splits: str, bare: bool = False) -> list[Sample]:
    """All views of the named splits (of all without a name), of people without their hair where it can be had."""
    shots = ((dataset, shot) for dataset in datasets for shot in dataset.shots)
    return [
        Sample(dataset, shot, view)
        for dataset, shot in shots for view in shot.shown(bare) if not splits or view.split in splits
    ]  # fmt: skip


def limited(candidates: Sequence[Sample], limit: int, seed: int = 0) -> list[Sample]:
    """Return at most `limit` of the views, drawn evenly over people by a fixed seed, in their order; all for 0.

    A plain stride would meet the same camera of every shot.
    """
    if not limit or len(candidates) <= limit:
        return list(candidates)
    rng = np.random.default_rng((seed, 11))
    by_person: dict[str, list[int]] = {}
    for index in rng.permutation(len(candidates)):
        sample = candidates[int(index)]
        by_person.setdefault(f"{sample.dataset.folder}/{sample.shot.subject}", []).append(int(index))
    chosen: list[int] = []
    rounds = max(len(indices) for indices in by_person.values())
    for turn in range(rounds):  # one of each person, then a second one of each
        for name in sorted(by_person):
            if turn < len(by_person[name]) and len(chosen) < limit:
                chosen.append(by_person[name][turn])
    return [candidates[index] for index in sorted(chosen)]


def source_view(candidates: Sequence[Sample]) -> Sample:
    """Return the view that a person is fitted from: neutral if there is one, seen from the front, with the whole head.

    Raises:
        ConfigError: There is no view of the person.
    """
    if not candidates:
        raise ConfigError("A held-out person has no views to be fitted from; capture more views.")

    def rank(sample: Sample) -> tuple[float, float]:
        penalty = (0.0 if sample.neutral else 20.0) + (25.0 if sample.close else 0.0)
        return penalty + abs(sample.yaw), float(sample.shot.number)

    return min(candidates, key=rank)
