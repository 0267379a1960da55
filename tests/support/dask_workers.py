"""Two processes of a local cluster for tests, prepared by some code, also those that come after one is killed."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from grmm_core.jobs.cluster import Cluster, open_cluster

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def two_workers(prepare: str) -> Iterator[Cluster]:
    """Start them; `prepare` is Python that runs in each first. Tests' modules are found there as they are here."""
    dask = pytest.importorskip("dask")
    pytest.importorskip("distributed")
    with (
        pytest.MonkeyPatch.context() as patch,
        dask.config.set({"distributed.worker.preload": [prepare]}),
    ):
        patch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if Path(path).is_relative_to(ROOT)))
        with open_cluster("local:2") as cluster:
            yield cluster


def address(cluster: Cluster) -> str:
    """Of its scheduler, for --cluster."""
    return cluster._client.scheduler.address


def processes(cluster: Cluster) -> set[int]:
    """Ids of its workers' processes."""
    return set(cluster._client.run(os.getpid).values())


def kill_once_there_is(pattern: str, folder: Path, cluster: Cluster) -> Callable[..., None]:
    """A `Share` that kills one of the workers when the first file of a pattern is in a folder."""
    killed: list[int] = []

    def report(*_: object) -> None:
        if not killed and any(folder.glob(pattern)):
            killed.append(min(processes(cluster)))
            os.kill(killed[0], signal.SIGKILL)

    report.killed = killed
    return report
