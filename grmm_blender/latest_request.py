"""Work on a thread for the latest of many requests, as a viewport makes them while it moves.

`LatestRequestThread` is the letter box between Blender's main thread, which asks and takes, and one thread, which works and
ends when nothing is left to do. `engine.view_jobs` (pictures) and `viewport.jobs` (splats) say what the work is. Touches none
of Blender's data.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Request = TypeVar("Request")
Result = TypeVar("Result")
WaitForRest = Callable[[Callable[[], bool]], object]


class LatestRequestThread(Generic[Request, Result]):
    """Serves the latest request. A class gives `_serve` and `_failed`, and calls `_put` with results."""

    thread_name = "GRMM"

    def __init__(self, rest_seconds: float, wait_for_rest: WaitForRest | None = None) -> None:
        """Prepare; nothing runs before the first request.

        Args:
            rest_seconds: Without a newer request, before the costly part of the work is begun.
            wait_for_rest: Waits for that instead; called with a function that says whether there is something newer.
        """
        self._rest_seconds = rest_seconds
        self._wait_for_rest = wait_for_rest or self._wait_a_moment
        self._changed = threading.Condition()
        self._wanted: Request | None = None
        self._result: Result | None = None
        self._thread: threading.Thread | None = None

    def request(self, request: Request | None) -> None:
        """Ask for something; returns at once. None gives up."""
        with self._changed:
            self._wanted = request
            if self._thread is None and request is not None:
                self._thread = threading.Thread(target=self._run, name=self.thread_name, daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def take(self) -> Result | None:
        """Return what was finished since the last call, else None."""
        with self._changed:
            found, self._result = self._result, None
            return found

    @property
    def busy(self) -> bool:
        """Whether something is being made, or waits to be taken."""
        with self._changed:
            return self._thread is not None or self._result is not None

    @property
    def has_news(self) -> bool:
        """Whether something waits to be taken."""
        with self._changed:
            return self._result is not None

    def wait_for_news(self, timeout: float) -> bool:
        """Wait until something waits to be taken; returns whether that came."""
        with self._changed:
            return self._changed.wait_for(lambda: self.has_news or self._thread is None, timeout) and self.has_news

    def wait(self, timeout: float) -> bool:
        """Wait until nothing is left to do; returns whether that came."""
        with self._changed:
            return self._changed.wait_for(lambda: self._thread is None, timeout)

    def _serve(self, request: Request) -> bool:
        """Do the work, on the thread; returns whether it is done, else it is begun again while nothing newer is wanted."""
        raise TypeError(f"{type(self).__name__} serves nothing")

    def _failed(self, request: Request, error: Exception) -> None:
        """Hear of an error of `_serve`; the request counts as done."""
        raise TypeError(f"{type(self).__name__} hears of no errors")

    def _put(self, result: Result) -> None:
        with self._changed:
            self._result = result
            self._changed.notify_all()

    def _wait_a_moment(self, is_outdated: Callable[[], bool]) -> None:
        with self._changed:
            self._changed.wait_for(is_outdated, self._rest_seconds)

    def _run(self) -> None:
        done: Request | None = None
        while True:
            with self._changed:
                request = self._wanted
                if request is None or request is done:
                    self._thread = None
                    self._changed.notify_all()
                    return
            try:
                finished = self._serve(request)
            except Exception as error:  # noqa: BLE001 - a thread has no caller that would hear of it
                self._failed(request, error)
                finished = True
            if finished:
                done = request
