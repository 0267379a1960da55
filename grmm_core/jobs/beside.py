"""Work that is done beside other work of the same process, on a thread of its own, and stops when that does."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from ..errors import CancelledError
from .progress import Share

Value = TypeVar("Value")


@contextlib.contextmanager
def beside(work: Callable[[Share], Value]) -> Iterator[Future[Value]]:
    """Do work while a block runs, at whose end it is waited for.

    Args:
        work: Takes a `Share`, which ends it by `CancelledError` once the block has ended by an error.
    """
    stopped = threading.Event()

    def report(share: float, message: str = "") -> None:
        if stopped.is_set():
            raise CancelledError("The work beside this one has ended.")

    with ThreadPoolExecutor(1, thread_name_prefix="grmm-beside") as pool:
        future = pool.submit(work, report)
        try:
            yield future
        except BaseException:
            stopped.set()
            raise
