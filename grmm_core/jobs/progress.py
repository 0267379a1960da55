"""How far a piece of work is: the record, who makes it, and the one estimate of the time left.

    report = Reporter(FIT, show, cancelled)
    report("analyse", 0.5)                      # show(Progress("analyse", 0.15, 52.0))
    track_photos(..., progress=report.part("track"))

A producer's records are well-formed: stages in the table's order, fractions that never fall, seconds left finite or NaN.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from ..errors import CancelledError
from .stages import JobStages

TRUST_SECONDS = 15.0  # of expected time after which what was measured counts as much as what was expected


@dataclass(frozen=True)
class Progress:
    """Where a piece of work stands.

    Attributes:
        stage: Name of the stage, from the work's table.
        fraction: Share of the whole that is done, 0..1; never falls.
        seconds_left: Until the whole is done; NaN while unknown, else finite.
        picture: File of the latest picture of it, or "".
        message: What is being done just now, for people, or "".
    """

    stage: str = ""
    fraction: float = 0.0
    seconds_left: float = math.nan
    picture: str = ""
    message: str = ""

    def to_json(self) -> dict[str, object]:
        """As JSON values; an unknown time is null."""
        left = None if math.isnan(self.seconds_left) else round(self.seconds_left, 1)
        return {
            "stage": self.stage, "fraction": round(self.fraction, 4), "seconds_left": left, "picture": self.picture,
            "message": self.message,
        }  # fmt: skip

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> Progress:
        """Read what `to_json` gave. Raises `KeyError`, `ValueError` or `TypeError` where it is something else."""
        left = values.get("seconds_left")
        fraction, seconds = float(values["fraction"]), math.nan if left is None else float(left)
        if not 0.0 <= fraction <= 1.0 or math.isinf(seconds):
            raise ValueError(f"{fraction} and {seconds} are no share and no time")
        picture, message = (str(values.get(name) or "") for name in ("picture", "message"))
        return Progress(str(values["stage"]), fraction, seconds, picture, message)

    def text(self, stages: JobStages) -> str:
        """One line for people: what is being done, and how long that will take."""
        label = self.message or next((stage.label for stage in stages.stages if stage.name == self.stage), "Starting")
        left = duration(self.seconds_left)
        return f"{label}, about {left} left" if left else label


ProgressCallback = Callable[[Progress], None]
"""Called often while a piece of work runs."""


class Share(Protocol):
    """Hears how much of one part of a piece of work is done; may raise `CancelledError`, which ends the part."""

    def __call__(self, share: float, message: str = "") -> None:
        """Hear of a share 0..1 and what is being done."""


def nobody(share: float, message: str = "") -> None:
    """A `Share` that is not heard."""


def within(report: Share, begin: float, end: float) -> Share:
    """A `Share` for the stretch of a larger part that lies between two of its shares."""

    def part(share: float, message: str = "") -> None:
        report(begin + (end - begin) * share, message)

    return part


def duration(seconds: float) -> str:
    """A time for people ("40 s", "3 min", "2 h 5 min"); "" for NaN."""
    if math.isnan(seconds):
        return ""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


class TimeLeft:
    """Estimates the time left from the share done. What was done in an earlier run took no time in this one.

    Args:
        expected: Seconds that the whole takes on the machine of the table; NaN where nobody knows. With it there is an
            estimate from the beginning, which follows what this machine does as time goes by.
        clock: Seconds.
    """

    def __init__(self, expected: float = math.nan, clock: Callable[[], float] = time.monotonic) -> None:
        self._expected, self._clock = expected, clock
        self._start, self._skipped = clock(), 0.0

    def skip(self, share: float) -> None:
        """A share of the whole was done before."""
        self._skipped += share

    def seconds(self, fraction: float) -> float:
        """Seconds left when a share of the whole is done, this run's and earlier ones'; NaN while unknown."""
        elapsed, done = self._clock() - self._start, max(fraction - self._skipped, 0.0)
        if math.isnan(self._expected):
            return elapsed / done * (1.0 - fraction) if done > 0.0 else math.nan
        slowness = (elapsed + TRUST_SECONDS) / (done * self._expected + TRUST_SECONDS)
        return slowness * (1.0 - fraction) * self._expected


class Reporter:
    """Makes the progress of one piece of work, and carries the wish to cancel it.

    Args:
        stages: Of this kind of work.
        callback: Hears every record; None for nobody.
        cancelled: Asked often; True is the wish to stop.
        clock: Seconds.
    """

    def __init__(
        self, stages: JobStages, callback: ProgressCallback | None = None, cancelled: Callable[[], bool] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self.stages = stages
        self._callback, self._cancelled = callback, cancelled
        self._left = TimeLeft(stages.weight if stages.timed else math.nan, clock)
        self._place, self._end = -1, 0.0  # of the stage in the table; share of the whole at its end
        self._last = Progress()

    def __call__(self, stage: str, share: float, message: str = "", picture: str = "") -> None:
        """Report.

        Args:
            stage: One of the work's, not before the one that was reported last.
            share: How much of the stage is done, 0..1. Less than was reported before counts as no change.
            message: What is being done.
            picture: File of a new picture.
        """
        place = self.stages.position(stage)
        if place < self._place:
            raise ValueError(f"{stage} comes before {self._last.stage}, which was reported already")
        begin, end = self.stages.span(stage)
        fraction = begin + (end - begin) * min(max(share, 0.0), 1.0)
        if place > self._place:  # stages that nobody reported, and a share to begin with, are from an earlier run
            self._left.skip(fraction - self._end)
            self._place, self._end = place, end
        fraction = min(max(fraction, self._last.fraction), 1.0)
        self._last = Progress(stage, fraction, self._left.seconds(fraction), picture or self._last.picture, message)
        if self._callback is not None:
            self._callback(self._last)

    def part(self, stage: str) -> Share:
        """A function for one stage's work, which reports its share and ends it by `CancelledError` on request."""

        def report(share: float, message: str = "") -> None:
            self.check()
            self(stage, share, message)

        return report

    @property
    def has_listener(self) -> bool:
        """Whether anybody hears the records; costly pictures are not made for nobody."""
        return self._callback is not None

    @property
    def wants_to_stop(self) -> bool:
        """Whether the user has cancelled."""
        return self._cancelled is not None and self._cancelled()

    def check(self) -> None:
        """Raise `CancelledError` if the user has cancelled."""
        if self.wants_to_stop:
            raise CancelledError(f"The {self.stages.label} was cancelled.")
