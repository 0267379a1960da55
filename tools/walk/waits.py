"""Inside Blender: notes what keeps the main thread, so that nothing answers for longer than a moment.

A thread looks at what Python the main thread runs, many times a second. One call from Blender into Python that goes on for
`LEAST_SECONDS` is a wait: how long, how much of that the main thread computed, and where it was most of the time. Blender's own
drawing is not Python and does not count, which on software OpenGL would be all that is seen. Needs nothing of the project.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from types import FrameType

LEAST_SECONDS = 0.7
LOOK_SECONDS = 0.02
OWN = "/extensions/user_default/"  # in the paths of what the zip brought


class Watch(threading.Thread):
    """Writes waits to a file, one JSON object a line: `seconds`, `processor_seconds`, `place`, `callers`."""

    def __init__(self, path: Path) -> None:
        super().__init__(name="walk waits", daemon=True)
        self._path = path
        self._main = threading.main_thread()

    def run(self) -> None:
        """Look until Blender ends."""
        current, begin, spent, seen = 0, 0.0, 0.0, Counter[str]()
        while True:
            time.sleep(LOOK_SECONDS)
            frames = _stack(sys._current_frames().get(self._main.ident or 0))
            outermost = id(_entry(frames)) if frames else 0
            now = time.monotonic()
            if outermost != current:
                if current and now - begin >= LEAST_SECONDS:
                    self._write(now - begin, self._spent() - spent, seen)
                current, begin, spent, seen = outermost, now, self._spent(), Counter()
            if frames:
                seen[_place(frames)] += 1

    def _spent(self) -> float:
        try:
            text = Path(f"/proc/self/task/{self._main.native_id}/stat").read_text("utf-8")
        except OSError:
            return 0.0
        return sum(map(int, text.rpartition(")")[2].split()[11:13])) / 100.0

    def _write(self, seconds: float, spent: float, seen: Counter[str]) -> None:
        found = {"seconds": round(seconds, 2), "processor_seconds": round(spent, 2), "places": seen.most_common(3)}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(found) + "\n")


def _stack(frame: FrameType | None) -> list[FrameType]:
    """The frames that run, the innermost first."""
    found = []
    while frame is not None:
        found.append(frame)
        frame = frame.f_back
    return found


def _entry(frames: list[FrameType]) -> FrameType:
    """The call that came from Blender: the outermost of the extension, or the outermost of all."""
    return next((frame for frame in reversed(frames) if OWN in frame.f_code.co_filename), frames[-1])


def _place(frames: list[FrameType]) -> str:
    """The extension's function that waits and the one that Blender called, or the innermost function of all."""
    own = [frame for frame in frames if OWN in frame.f_code.co_filename]
    parts = [own[0], own[-1]] if own else [frames[0], frames[-1]]
    return " < ".join(f"{Path(part.f_code.co_filename).name}:{part.f_lineno} {part.f_code.co_name}" for part in parts)
