"""Pieces of a job on Dask's scheduler: order, errors, cancelling, workers that are not fit for it."""

from __future__ import annotations

import os
import signal

import pytest

from grmm_core.errors import CancelledError, ConfigError, NoFaceError, RuntimeMissingError, SessionError
from grmm_core.jobs import cluster as clusters
from grmm_core.jobs.cluster import open_cluster, run_pieces
from grmm_core.jobs.progress import nobody

pytest.importorskip("distributed")


def double(piece, report):
    report(0.5)
    return 2 * piece


def refuse(piece, report):
    raise NoFaceError(f"There is no face in {piece}.")


def die(piece, report):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture(scope="module")
def cluster():
    with open_cluster("local:2") as cluster:
        yield cluster


def test_results_are_those_of_one_process(cluster):
    heard = []
    here = list(run_pieces(double, [3, 1, 2], lambda share, message="": heard.append(round(share, 3))))
    assert here == [(0, 6), (1, 2), (2, 4)]
    assert heard == [0.167, 0.333, 0.5, 0.667, 0.833, 1.0]
    heard.clear()
    assert sorted(run_pieces(double, [3, 1, 2], lambda share, message="": heard.append(share), cluster)) == here
    assert heard == sorted(heard)
    assert (heard[0], heard[-1]) == (0.0, 1.0)
    assert list(run_pieces(double, [], nobody, cluster)) == []
    assert "2 workers, dashboard at http" in cluster.description


def test_errors_of_the_work_arrive_as_they_are(cluster):
    with pytest.raises(NoFaceError, match=r"There is no face in a\.jpg\."):
        list(run_pieces(refuse, ["a.jpg"], nobody, cluster))


def test_the_wish_to_cancel_is_heard(cluster):
    def stop(share, message=""):
        raise CancelledError("stopped")

    with pytest.raises(CancelledError):
        list(run_pieces(double, [1], stop, cluster))
    assert list(run_pieces(double, [1], nobody, cluster)) == [(0, 2)]


def test_a_piece_that_ends_its_workers_is_given_up(cluster):
    with pytest.raises(SessionError, match=r"Several workers in a row ended over the same piece of work \(die-"):
        list(run_pieces(die, [0], nobody, cluster))
    assert list(run_pieces(double, [1], nobody, cluster)) == [(0, 2)]


def test_unfit_workers_are_refused(cluster, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(clusters, "__version__", "0.0.0")
    with pytest.raises(ConfigError, match=r"and the job is of 0\.0\.0; install the same"):
        list(run_pieces(double, [1], nobody, cluster))
    monkeypatch.undo()
    with (
        LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address="127.0.0.1:0") as other,
        open_cluster(other.scheduler_address) as named,
        pytest.raises(ConfigError, match="does 2 pieces at once"),
    ):
        list(run_pieces(double, [1], nobody, named))


@pytest.mark.parametrize("text", ["local", "local:0", "local:x", "here", "tcp://host", "a b:1"])
def test_what_is_no_cluster_is_refused(text):
    with pytest.raises(ConfigError, match=r"--cluster .* is not possible; write local:4"), open_cluster(text):
        pass


def test_what_is_missing_is_said(monkeypatch):
    monkeypatch.setattr(clusters, "CONNECT_SECONDS", 0.5)
    for address in ("127.0.0.1:9", "ftp://127.0.0.1:9"):
        with pytest.raises(SessionError, match=f"No Dask scheduler answers at {address}"), open_cluster(address):
            pass
    monkeypatch.setattr(clusters.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeMissingError, match=r'pip install "\.\[cluster\]" in the checkout'), open_cluster("local:2"):
        pass
    with open_cluster(None) as nothing:
        assert nothing is None
