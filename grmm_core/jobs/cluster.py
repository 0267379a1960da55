"""Many pieces of one job: here one after another, or on several processes and machines by Dask's distributed scheduler.

    with open_cluster("local:4") as cluster:                     # None where no cluster is named
        for number, result in run_pieces(work, pieces, report, cluster):
            ...

Dask hands out the pieces, does those of a lost worker again elsewhere, and shows all on its dashboard. Pieces travel by pickle
between processes of the job's owner, so functions of pieces stand in modules; files are written by whoever does a piece, into
folders that all machines see under one name. Needs the package's extra `cluster`, imported when a cluster is opened.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import queue
import re
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeVar

from .. import __version__
from ..errors import ConfigError, GrmmError, RuntimeMissingError, SessionError
from .progress import Share, nobody, within

if TYPE_CHECKING:
    from distributed import Client

CONNECT_SECONDS = 20.0
POLL_SECONDS = 0.5  # between two questions whether the user has cancelled
RETRIES = 2  # after errors; after lost workers as often as Dask's `allowed-failures` says, three times unless configured
LOCAL = re.compile(r"local:([1-9]\d{0,3})")
FORMS = "write local:4 for four processes of this machine, or a scheduler's address such as tcp://10.0.0.5:8786"

Piece = TypeVar("Piece")
Result = TypeVar("Result")


def run_pieces(
    work: Callable[[Piece, Share], Result], pieces: Sequence[Piece], report: Share = nobody, cluster: Cluster | None = None
) -> Iterator[tuple[int, Result]]:
    """Do all pieces; yields their numbers and results, in order here and as they are done on a cluster.

    Args:
        work: Does one, and tells how much of it is done; on a cluster a function of a module, which nobody hears.
        pieces: What is to be done; on a cluster whatever can be pickled.
        report: Hears how much of all is done; an exception of it ends the work.
        cluster: Where; None for this process.

    Raises:
        GrmmError: As the work does. On a cluster also `SessionError`: several workers ended over a piece, or the scheduler.
    """
    if cluster is not None:
        yield from cluster.run(work, pieces, report)
        return
    for number, piece in enumerate(pieces):
        begin, end = number / len(pieces), (number + 1) / len(pieces)
        yield number, work(piece, within(report, begin, end))
        report(end)


@contextmanager
def open_cluster(text: str | None) -> Iterator[Cluster | None]:
    """Connect to a cluster while the block runs; to none where nothing is named.

    Args:
        text: "local:N" starts so many processes on this machine; else the address of a scheduler.

    Raises:
        ConfigError: The text says neither.
        RuntimeMissingError: Dask is not installed.
        SessionError: There is no scheduler.
    """
    if not text:
        yield None
        return
    local = LOCAL.fullmatch(text)
    if local is None and (text.startswith("local") or not re.fullmatch(r"(\w+://)?[^\s/:]+:\d+", text)):
        raise ConfigError(f"--cluster {text} is not possible; {FORMS}.")
    if importlib.util.find_spec("distributed") is None:
        raise RuntimeMissingError('A cluster needs Dask; run pip install ".[cluster]" in the checkout.')
    import dask
    from distributed import Client, LocalCluster

    if not logging.getLogger().isEnabledFor(logging.DEBUG):
        logging.getLogger("distributed").setLevel(logging.ERROR)  # else it tells of every connection
    if local is None:
        try:
            client = Client(text, timeout=CONNECT_SECONDS)
        except (OSError, ValueError) as error:  # ValueError: an unknown kind of address
            raise SessionError(f"No Dask scheduler answers at {text}; start one with dask scheduler, or {FORMS}.") from error
        with client:
            yield Cluster(client, 1)
        return
    count = int(local[1])
    # Work of this package takes gigabytes for a moment; the system is the better judge of what is too much.
    options: dict[str, Any] = {"host": "127.0.0.1", "memory_limit": None, "silence_logs": logging.ERROR}
    with (
        TemporaryDirectory(prefix="grmm-cluster-", ignore_cleanup_errors=True) as scratch,
        dask.config.set({"temporary-directory": scratch}),
        LocalCluster(n_workers=count, threads_per_worker=1, **options) as processes,
        Client(processes) as client,
    ):
        yield Cluster(client, max(1, (os.cpu_count() or 1) // count))


class Cluster:
    """A connection to a scheduler.

    Attributes:
        threads: Threads that one piece may use, where the user does not say.
    """

    def __init__(self, client: Client, threads: int) -> None:
        self._client, self.threads = client, threads

    @property
    def description(self) -> str:
        """What there is, for people."""
        count = len(self._addresses())
        return f"{count} worker{'s' * (count != 1)}, dashboard at {self._client.dashboard_link}"

    def run(
        self, work: Callable[[Piece, Share], Result], pieces: Sequence[Piece], report: Share = nobody
    ) -> Iterator[tuple[int, Result]]:
        """As `run_pieces`."""
        name = f"{getattr(work, '__name__', 'work').strip('_')}-{uuid.uuid4().hex[:8]}"
        done: queue.Queue[tuple[int, Any]] = queue.Queue()
        futures = {}
        try:
            for number, piece in enumerate(pieces):
                future = self._client.submit(
                    _carry_out, work, piece, __version__, key=f"{name}-{number}", retries=RETRIES, priority=-number, pure=False
                )
                futures[number] = future
                future.add_done_callback(lambda future, number=number: done.put((number, future)))
            while futures:
                report(1.0 - len(futures) / len(pieces))
                try:
                    number, future = done.get(timeout=POLL_SECONDS)
                except queue.Empty:
                    continue
                yield number, _result_of(future)
                del futures[number]
            report(1.0)
        finally:
            self._client.cancel(list(futures.values()))

    def everywhere(self, function: Callable[[], None]) -> None:
        """Call a function once on every worker, where pieces run too."""
        calls = [self._client.submit(function, workers=[address], pure=False) for address in self._addresses()]
        for call in calls:
            call.exception()  # waits; a worker that has gone needs no call

    def _addresses(self) -> list[str]:
        return list(self._client.scheduler_info(n_workers=-1)["workers"])


def _carry_out(work: Callable[[Piece, Share], Result], piece: Piece, version: str) -> Result:
    """Do a piece on a worker."""
    from distributed import get_worker

    worker = get_worker()
    if version != __version__:
        raise ConfigError(f"The worker {worker.address} has GRMM {__version__}, and the job is of {version}; install the same.")
    # Blender's module, and thread counts of libraries, belong to the process and not to a thread.
    if worker.state.nthreads != 1:
        raise ConfigError(
            f"The worker {worker.address} does {worker.state.nthreads} pieces at once in one process; start it with "
            "dask worker --nworkers N --nthreads 1."
        )
    return work(piece, nobody)


def _result_of(future: Any) -> Any:
    """A finished future's result, its errors as ours."""
    from distributed import KilledWorker
    from distributed.client import FutureCancelledError

    try:
        return future.result()
    except GrmmError:
        raise
    except KilledWorker as error:
        raise SessionError(
            f"Several workers in a row ended over the same piece of work ({future.key}), and out of memory is the usual "
            "reason; use fewer workers, or machines with more."
        ) from error
    except (FutureCancelledError, OSError) as error:
        raise SessionError("The connection to the scheduler is lost; run the command again, what was made stays.") from error
