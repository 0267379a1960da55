"""The stages of every kind of work, in their order: names, labels for people, and what share of the time each takes.

The one table that producers of progress, the console and Blender's panels read. A new kind of work is a new entry.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes:
        name: Identifier.
        label: For people.
        weight: Time that it takes: seconds on two cores where the work is `timed`, else relative to the other stages.
    """

    name: str
    label: str
    weight: float = 1.0


@dataclass(frozen=True)
class JobStages:
    """A kind of work and its stages.

    Attributes:
        label: What it is, for people: "fit".
        stages: In their order.
        timed: Whether the weights are seconds, so that the time left is known before anything is done.
    """

    label: str
    stages: tuple[Stage, ...]
    timed: bool = False

    def __getitem__(self, name: str) -> Stage:
        """The stage of a name. Raises `KeyError`."""
        return self.stages[self.position(name)]

    def position(self, name: str) -> int:
        """Place of a stage in the order. Raises `KeyError`."""
        for place, stage in enumerate(self.stages):
            if stage.name == name:
                return place
        raise KeyError(name)

    @property
    def weight(self) -> float:
        """Of all stages together."""
        return sum(stage.weight for stage in self.stages)

    def span(self, name: str) -> tuple[float, float]:
        """Where a stage begins and ends, as shares of the whole."""
        place = self.position(name)
        before = sum(stage.weight for stage in self.stages[:place])
        return before / self.weight, (before + self.stages[place].weight) / self.weight

    def weighted(self, weights: Mapping[str, float]) -> JobStages:
        """The same with other weights of some stages."""
        stages = (dataclasses.replace(stage, weight=weights.get(stage.name, stage.weight)) for stage in self.stages)
        return dataclasses.replace(self, stages=tuple(stages))

    def only(self, names: Iterable[str]) -> JobStages:
        """The same with these stages alone."""
        wanted = set(names)
        return dataclasses.replace(self, stages=tuple(stage for stage in self.stages if stage.name in wanted))


FIT = JobStages(
    "fit",
    (
        Stage("load", "Starting", 3.0),
        Stage("analyse", "Looking for faces", 0.5),
        Stage("track", "Tracking", 18.0),
        Stage("codes", "Finding the person", 30.0),  # this and the next depend on the preset, see `fitting.presets`
        Stage("decoders", "Fine detail", 85.0),
        Stage("finish", "Finishing", 14.0),  # the color and texture of hair, the thumbnail and the painting
    ),
    timed=True,
)
PEOPLE = JobStages("fits", (Stage("people", "Fitting"),))
PIECES = JobStages("evaluation on a cluster", (Stage("pieces", "Measuring"),))  # which end in any order
FIND_FACES = JobStages("search for faces", (Stage("load", "Starting", 4.0), Stage("analyse", "Looking for faces", 2.0)))
TRACK = JobStages(
    "performance capture",
    (
        Stage("load", "Starting", 3.0),
        Stage("read", "Following the face", 20.0),  # this and the last of some 600 frames; both grow with the video
        Stage("person", "Finding the person", 4.0),
        Stage("solve", "Solving expressions", 14.0),
    ),
)
SPEAK = JobStages(
    "performance from a voice",
    (
        Stage("read", "Reading the recording", 1.0),
        Stage("listen", "Listening", 20.0),
        Stage("act", "Moving the face", 2.0),
    ),
)
CAPTURE = JobStages("capture", (Stage("shots", "Rendering"),))
TRAINING = JobStages("training", (Stage("prepare", "Preparing", 0.01), Stage("steps", "Training")))
EVALUATION = JobStages(
    "evaluation",
    (
        Stage("reconstruction", "Training views"),
        Stage("novel-view", "Held-out cameras"),
        Stage("expression", "Held-out expressions"),
        Stage("person", "Held-out people"),
        Stage("monocular", "Single photos"),
        Stage("transfer", "Expressions of others"),
        Stage("codes", "Codes"),
    ),
)
BENCHMARK = JobStages(
    "benchmark",
    (
        Stage("stages", "Stages of a frame"),
        Stage("engines", "With torch and without"),
        Stage("caching", "What is kept"),
        Stage("light", "In lights"),
        Stage("resolution", "Sizes"),
        Stage("detail", "Levels of detail"),
        Stage("hair", "Hair of strands"),
        Stage("worker", "Worker"),
        Stage("rasteriser", "Rasteriser", 3.0),
    ),
)
EXPORT = JobStages("export", (Stage("write", "Exporting"),))
INSTALL = JobStages(
    "installation",
    (
        Stage("environment", "Making the environment", 5.0),
        Stage("download", "Fetching packages", 65.0),
        Stage("install", "Installing packages", 25.0),
        Stage("check", "Trying the runtime", 5.0),
    ),
)
