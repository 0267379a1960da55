"""Work on a thread of its own ends with the work that it is beside."""

from __future__ import annotations

import threading

import pytest

from grmm_core.errors import CancelledError, ConfigError
from grmm_core.jobs.beside import beside


def test_both_run_at_a_time_and_the_result_is_there_at_the_end():
    here, there = threading.Event(), threading.Event()

    def work(report):
        there.set()
        assert here.wait(10.0)
        report(1.0)
        return threading.current_thread()

    with beside(work) as found:
        assert there.wait(10.0)
        here.set()
    assert found.result(0.0) is not threading.current_thread()


def test_an_error_of_the_block_ends_the_work_at_its_next_report():
    begun = threading.Event()

    def work(report):
        while True:
            report(0.0)
            begun.set()

    def block():
        with beside(work) as found:
            works.append(found)
            assert begun.wait(10.0)
            raise ConfigError("The block cannot go on.")

    works = []
    with pytest.raises(ConfigError, match="The block"):
        block()
    assert isinstance(works[0].exception(0.0), CancelledError)


def test_an_error_of_the_work_is_that_of_its_result():
    def work(report):
        raise ConfigError("The work cannot go on.")

    with beside(work) as found:
        pass
    with pytest.raises(ConfigError, match="The work"):
        found.result(0.0)
