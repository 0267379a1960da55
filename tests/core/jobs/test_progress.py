"""Progress of work that takes a while: well-formed records, the estimate of the time left, JSON, the stages' table."""

from __future__ import annotations

import dataclasses
import itertools
import math

import pytest
from progress_checks import check_progress

from grmm_core.errors import CancelledError
from grmm_core.jobs import stages
from grmm_core.jobs.progress import TRUST_SECONDS, Progress, Reporter, TimeLeft, duration, within
from grmm_core.jobs.stages import FIT, JobStages, Stage

HALVES = JobStages("test", (Stage("one", "First"), Stage("two", "Second")))


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_records_are_well_formed_whatever_is_reported():
    seen: list[Progress] = []
    report = Reporter(HALVES, seen.append)
    for stage, share in (("one", 0.2), ("one", 0.1), ("one", 7.0), ("two", -1.0), ("two", 0.5), ("two", 1.0 + 1e-9)):
        report(stage, share)
    check_progress(seen, HALVES)
    assert [record.fraction for record in seen] == [0.1, 0.1, 0.5, 0.5, 0.75, 1.0]
    with pytest.raises(ValueError, match="one comes before two"):
        report("one", 1.0)
    with pytest.raises(KeyError):
        report("three", 0.0)


def test_a_picture_stays_until_there_is_another_and_a_message_does_not():
    seen: list[Progress] = []
    report = Reporter(HALVES, seen.append)
    report("one", 0.0, "drawing", "a.png")
    report("one", 0.5)
    report("one", 0.7, picture="b.png")
    assert [(record.message, record.picture) for record in seen] == [("drawing", "a.png"), ("", "a.png"), ("", "b.png")]


def test_parts_of_parts_report_into_the_whole():
    seen: list[Progress] = []
    report = Reporter(HALVES, seen.append)
    inner = within(within(report.part("two"), 0.0, 0.5), 0.5, 1.0)
    inner(0.0)
    inner(1.0, "half of a half")
    assert [record.fraction for record in seen] == [0.625, 0.75]
    assert seen[-1].message == "half of a half"


def test_the_wish_to_cancel_ends_a_part_and_not_a_report():
    cancelled = [False]
    report = Reporter(HALVES, None, lambda: cancelled[0])
    assert not report.has_listener
    part = report.part("one")
    part(0.1)
    cancelled[0] = True
    report("one", 0.2)
    for call in (lambda: part(0.3), report.check):
        with pytest.raises(CancelledError, match="The test was cancelled"):
            call()


def test_time_left_without_expectation_is_what_the_share_done_says(clock):
    left = TimeLeft(clock=clock)
    assert math.isnan(left.seconds(0.0))
    clock.now += 10.0
    assert left.seconds(0.25) == pytest.approx(30.0)
    assert left.seconds(1.0) == 0.0
    resumed = TimeLeft(clock=clock)
    resumed.skip(0.5)
    assert math.isnan(resumed.seconds(0.5))
    clock.now += 10.0
    assert resumed.seconds(0.75) == pytest.approx(10.0)


def test_time_left_begins_with_the_expectation_and_follows_the_machine(clock):
    left = TimeLeft(200.0, clock)
    assert left.seconds(0.0) == pytest.approx(200.0)
    estimates = []
    for step in range(1, 101):  # twice as slow as expected
        clock.now += 4.0
        estimates.append(left.seconds(step / 100))
    truth = [400.0 - 4.0 * step for step in range(1, 101)]
    errors = [abs(one - other) for one, other in zip(estimates, truth, strict=True)]
    assert errors == sorted(errors, reverse=True)
    assert errors[9] < 0.7 * (400.0 - 200.0)
    assert errors[-1] == 0.0
    slow = TimeLeft(200.0, clock)
    clock.now += 2 * TRUST_SECONDS  # a start that takes long alone, such as compiling, does not make minutes hours
    assert slow.seconds(0.01) < 3.0 * 200.0


def test_stages_of_an_earlier_run_took_no_time(clock):
    seen: list[Progress] = []
    work = JobStages("test", (Stage("load", "", 10.0), Stage("find", "", 30.0), Stage("tune", "", 60.0)), timed=True)
    report = Reporter(work, seen.append, clock=clock)
    report("load", 0.0)
    clock.now += 10.0
    report("tune", 0.5)  # found and half tuned before
    assert seen[-1].fraction == pytest.approx(0.7)
    assert seen[-1].seconds_left == pytest.approx(30.0), "loading went as expected"
    clock.now += 15.0
    report("tune", 0.75)
    assert seen[-1].seconds_left == pytest.approx(15.0)


def test_json_is_the_same_record_again():
    for record in (
        Progress("codes", 0.25, 12.5, "a.png", "step 3"), Progress("codes", 1.0, math.nan, "", "ü"), Progress(),
    ):  # fmt: skip
        again = Progress.from_json(record.to_json())
        assert math.isnan(again.seconds_left) == math.isnan(record.seconds_left)
        assert dataclasses.replace(again, seconds_left=0.0) == dataclasses.replace(record, seconds_left=0.0)
    for values in (
        {"stage": "codes", "fraction": math.nan}, {"stage": "codes", "fraction": 1.5}, {"stage": "codes", "fraction": "much"},
        {"stage": "codes", "fraction": 0.5, "seconds_left": math.inf}, {"stage": "codes", "fraction": None}, {"fraction": 0.5},
    ):  # fmt: skip
        with pytest.raises((KeyError, ValueError, TypeError)):
            Progress.from_json(values)


def test_people_read_one_line():
    assert Progress("one", 0.1, 40.0).text(HALVES) == "First, about 40 s left"
    assert Progress("two", 0.6, message="drawing Anna").text(HALVES) == "drawing Anna"
    assert Progress().text(HALVES) == "Starting"
    assert [duration(seconds) for seconds in (math.nan, 89.0, 170.0, 7500.0)] == ["", "89 s", "3 min", "2 h 5 min"]


def test_the_table_of_stages_covers_every_kind_of_work():
    kinds = [value for value in vars(stages).values() if isinstance(value, JobStages)]
    assert len(kinds) == len({kind.label for kind in kinds})
    for kind in kinds:
        names = [stage.name for stage in kind.stages]
        assert len(set(names)) == len(names) > 0
        assert all(stage.label and stage.weight > 0.0 for stage in kind.stages)
        ends = [kind.span(name) for name in names]
        assert ends[0][0] == 0.0
        assert ends[-1][1] == pytest.approx(1.0)
        assert all(before[1] == after[0] for before, after in itertools.pairwise(ends))


def test_stages_take_other_weights_and_fewer_stages():
    quick = FIT.weighted({"codes": 1.0, "decoders": 3.0}).only(("codes", "decoders"))
    assert [stage.name for stage in quick.stages] == ["codes", "decoders"]
    assert quick.span("decoders") == (0.25, 1.0)
    assert FIT["codes"].label == "Finding the person"
