"""A pool of threads for kernels that run without the interpreter lock.

Plain threads instead of numba's own parallel loops: these take seconds to compile, and some of numba's thread layers end the
process when two threads enter them at a time (Blender renders and draws its viewport from different ones) or after a fork.
The rasteriser and the model's own loops share the pool.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba

TASKS = 16  # parallel tasks per thread, so that threads end together
ROWS_MIN = 4096  # of a task of light rows

_pool: ThreadPoolExecutor | None = None
_pool_owner = 0  # process that started the pool; a forked child has no threads of its parent
_pool_size = 0


def thread_count() -> int:
    """Return the number of threads to use: the processors this process may run on, or NUMBA_NUM_THREADS when set."""
    config: Any = numba.config  # the settings are put there at run time
    return max(1, int(config.NUMBA_NUM_THREADS))


def pieces(count: int, smallest: int, most: int) -> list[tuple[int, int]]:
    """Split range(count) into at most `most` ranges of at least `smallest`, for parallel tasks."""
    size = max(smallest, -(-count // most), 1)
    return [(low, min(low + size, count)) for low in range(0, count, size)]


def for_rows(kernel: Callable[..., object], count: int, *arguments: object, smallest: int = ROWS_MIN) -> None:
    """Call a kernel that takes `arguments`, a first row and the one after the last for all of `count` rows, on all threads.

    A task has at least `smallest` rows.
    """
    ranges = pieces(count, smallest, TASKS * thread_count())
    for_each(len(ranges), lambda task: kernel(*arguments, *ranges[task]))


def for_each(tasks: int, call: Callable[[int], object]) -> None:
    """Run call(0) ... call(tasks - 1) on all threads, each taking the next task when it is free; raise the first error."""
    global _pool, _pool_owner, _pool_size
    helpers = min(thread_count(), tasks) - 1
    if helpers < 1:
        for task in range(tasks):
            call(task)
        return
    pool = _pool
    if pool is None or _pool_owner != os.getpid() or _pool_size < helpers:
        _pool_owner, _pool_size = os.getpid(), max(helpers, thread_count() - 1)
        pool = _pool = ThreadPoolExecutor(_pool_size, thread_name_prefix="grmm-splat")
    counter = itertools.count()

    def work() -> None:
        while (task := next(counter)) < tasks:
            call(task)

    waiting = [pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        for future in waiting:
            if not future.cancel():  # a helper that has not begun by now is busy elsewhere: nothing is left for it
                future.result()
