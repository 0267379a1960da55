"""Kill the workers of a session at random moments of a sequence. Standard library only: Blender's Python imports it too."""

from __future__ import annotations

import random
import threading
import time
from types import ModuleType
from typing import Any


class WorkerKiller:
    """Kills at seeded moments: while a picture is drawn, and a quarter of the time also while the next worker starts.

    No picture meets more than the two kills that it must survive: every other one meets none of its own, and no picture begins
    before what was planned for the one before the last is done.

    Attributes:
        done: Kills so far.
    """

    def __init__(self, process: ModuleType, pictures: int, kills: int, seed: int, draw: float, start: float) -> None:
        """Prepare.

        Args:
            process: The module `grmm_core.session.process`, under whatever name; its launches are watched.
            pictures: Length of the sequence.
            kills: How many.
            seed: Of the moments.
            draw: Seconds that an undisturbed picture takes.
            start: Seconds that a new worker and its first picture take.
        """
        chance = random.Random(seed)
        hit = sorted(chance.sample(range(0, pictures - 2, 2), kills - kills // 4))
        again = set(chance.sample(hit, kills // 4))
        # the picture that a kill waits for, how long then, and the last picture that it may meet
        self._plan = [
            (picture, chance.uniform(0.0, wait), picture + number)
            for picture in hit
            for number, wait in enumerate([draw, start] if picture in again else [draw])
        ]
        self._now, self._changed, self.done = -1, threading.Condition(), 0
        self._workers: list[Any] = []
        launch = process._launch

        def watched(*arguments: object) -> object:
            self._workers.append(launch(*arguments))
            return self._workers[-1]

        process._launch = watched
        threading.Thread(target=self._run, daemon=True).start()

    def picture(self, number: int) -> None:
        """Hear that a picture is begun."""
        with self._changed:
            self._changed.wait_for(lambda: all(last >= number for _, _, last in self._plan[self.done :]))
            self._now = number
            self._changed.notify_all()

    def _run(self) -> None:
        for picture, delay, _ in self._plan:
            with self._changed:
                self._changed.wait_for(lambda picture=picture: self._now >= picture)
            time.sleep(delay)
            while not self._workers or self._workers[-1].poll() is not None:
                time.sleep(0.002)
            self._workers[-1].kill()
            self._workers[-1].wait()
            with self._changed:
                self.done += 1
                self._changed.notify_all()
