"""Drag a file onto a window, as a file manager does: `python drag_source.py WINDOW X Y FILE`, in pixels of the screen.

The other side of the X desktops' drag and drop (XDND 5) in as little as it takes: a window of its own owns the selection, tells
the target what comes and where the mouse is, and hands the file's address over when asked. Runs where Blender runs, with the
standard library and libX11 alone; prints "accepted" or "refused", and ends with 0 once the target has taken the file.
"""

from __future__ import annotations

import ctypes as c
import sys
import time
from pathlib import Path

SELECTION_REQUEST, SELECTION_NOTIFY, CLIENT_MESSAGE = 30, 31, 33  # X's numbers of events
VERSION, PATIENCE, STEPS = 5, 20.0, 6


class Client(c.Structure):
    """XClientMessageEvent."""

    _fields_ = [
        ("type", c.c_int), ("serial", c.c_ulong), ("sent", c.c_int), ("display", c.c_void_p), ("window", c.c_ulong),
        ("message", c.c_ulong), ("format", c.c_int), ("data", c.c_long * 5),
    ]  # fmt: skip


class Request(c.Structure):
    """XSelectionRequestEvent."""

    _fields_ = [
        ("type", c.c_int), ("serial", c.c_ulong), ("sent", c.c_int), ("display", c.c_void_p), ("owner", c.c_ulong),
        ("requestor", c.c_ulong), ("selection", c.c_ulong), ("target", c.c_ulong), ("property", c.c_ulong), ("time", c.c_ulong),
    ]  # fmt: skip


class Notify(c.Structure):
    """XSelectionEvent."""

    _fields_ = [
        ("type", c.c_int), ("serial", c.c_ulong), ("sent", c.c_int), ("display", c.c_void_p), ("requestor", c.c_ulong),
        ("selection", c.c_ulong), ("target", c.c_ulong), ("property", c.c_ulong), ("time", c.c_ulong),
    ]  # fmt: skip


class Event(c.Union):
    """XEvent."""

    _fields_ = [("type", c.c_int), ("client", Client), ("request", Request), ("notify", Notify), ("room", c.c_long * 24)]


class Drag:
    """A file that is held over a window."""

    def __init__(self, target: int, path: Path) -> None:
        self._x = c.CDLL("libX11.so.6")
        self._x.XOpenDisplay.restype = c.c_void_p
        for name in ("XDefaultRootWindow", "XCreateSimpleWindow", "XInternAtom"):
            getattr(self._x, name).restype = c.c_ulong
        self._display = c.c_void_p(self._x.XOpenDisplay(None))
        root = c.c_ulong(self._x.XDefaultRootWindow(self._display))
        self._own = self._x.XCreateSimpleWindow(self._display, root, 0, 0, 1, 1, 0, c.c_ulong(0), c.c_ulong(0))
        self._target, self._text = target, f"{path.resolve().as_uri()}\r\n".encode()
        self._list = self._atom("text/uri-list")
        self._x.XSetSelectionOwner(self._display, c.c_ulong(self._atom("XdndSelection")), c.c_ulong(self._own), c.c_ulong(0))

    def drop(self, x: int, y: int) -> bool:
        """Move over the window to a place, let go there, and return whether the file was taken."""
        self._tell("XdndEnter", VERSION << 24, self._list, 0, 0)
        accepted = False
        for step in range(STEPS):
            at = (x - STEPS + 1 + step) << 16 | y
            self._tell("XdndPosition", 0, at, 0, self._atom("XdndActionCopy"))
            accepted = bool(self._wait("XdndStatus") & 1)
            time.sleep(0.1)
        print("accepted" if accepted else "refused", flush=True)
        if not accepted:
            self._tell("XdndLeave", 0, 0, 0, 0)
            return False
        self._tell("XdndDrop", 0, 0, 0, 0)
        self._wait("XdndFinished")
        return True

    def _atom(self, name: str) -> int:
        return int(self._x.XInternAtom(self._display, name.encode(), 0))

    def _tell(self, message: str, *data: int) -> None:
        event = Event()
        event.client = Client(
            CLIENT_MESSAGE, 0, 1, self._display, self._target, self._atom(message), 32, (c.c_long * 5)(self._own, *data)
        )
        self._x.XSendEvent(self._display, c.c_ulong(self._target), 0, c.c_long(0), c.byref(event))
        self._x.XFlush(self._display)

    def _wait(self, message: str) -> int:
        """Answer what the target asks until it says this; returns its flags."""
        wanted, ends, event = self._atom(message), time.monotonic() + PATIENCE, Event()
        while time.monotonic() < ends:
            if not self._x.XPending(self._display):
                time.sleep(0.01)
                continue
            self._x.XNextEvent(self._display, c.byref(event))
            if event.type == SELECTION_REQUEST:
                self._hand_over(event.request)
            elif event.type == CLIENT_MESSAGE and event.client.message == wanted:
                return int(event.client.data[1])
        raise TimeoutError(f"the window never says {message}")

    def _hand_over(self, asked: Request) -> None:
        known = asked.target == self._list
        if known:
            self._x.XChangeProperty(
                self._display, c.c_ulong(asked.requestor), c.c_ulong(asked.property), c.c_ulong(self._list), 8, 0,
                self._text, len(self._text),
            )  # fmt: skip
        answer = Event()
        answer.notify = Notify(
            SELECTION_NOTIFY, 0, 1, self._display, asked.requestor, asked.selection, asked.target,
            asked.property if known else 0, asked.time,
        )  # fmt: skip
        self._x.XSendEvent(self._display, c.c_ulong(asked.requestor), 0, c.c_long(0), c.byref(answer))
        self._x.XFlush(self._display)


if __name__ == "__main__":
    window, across, down, file = sys.argv[1:]
    sys.exit(0 if Drag(int(window, 0), Path(file)).drop(int(across), int(down)) else 1)
