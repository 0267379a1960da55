"""One text that says what runs where, for bug reports.

Nothing personal goes in: the home folder becomes "~". Used by the preferences and the panels.
"""

from __future__ import annotations

import platform
import sys
from pathlib import Path

import bpy
import numpy as np

from ..grmm_core import __version__
from . import compat, runtime_install, session_host


def report() -> str:
    """Return the diagnostics as lines "name: value", followed by the logs."""
    status = session_host.runtime_status()
    settings = session_host.settings()
    machine = runtime_install.detect_machine()
    facts = {
        "GRMM": __version__,
        "Blender": f"{bpy.app.version_string} {_build()}",
        "Python": f"{platform.python_version()} ({sys.executable})",
        "System": f"{platform.platform()} {platform.machine()}",
        "Machine": f"{machine.system}, accelerator {machine.accelerator or 'none'}",
        "numpy": np.__version__,
        "Graphics": _graphics(),
        "Online access": bpy.app.online_access,
        "Background": bpy.app.background,
        "Runtime": status.message,
        "Runtime settings": settings,
        "Installed runtime": _installed(),
    }
    session = status.session
    if session is not None:
        facts |= {
            "Session": f"{session.kind}, {'alive' if session.alive else 'not running'}, {session.restarts} restarts",
            "Session Python": session.python,
            "torch": session.torch or "not loaded",
            "Device": session.device,
            "Threads": session.threads,
            "Memory": f"{session.memory_bytes / 2**20:.0f} MB",
        }
    lines = [f"{name}: {value}" for name, value in facts.items()]
    if session is not None and session.log:
        lines += ["", "Worker's last lines:", session.log]
    return _without_home("\n".join(lines))


def _build() -> str:
    value = bpy.app.build_hash
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _graphics() -> str:
    if bpy.app.background:
        return "none in background"
    import gpu

    return f"{gpu.platform.vendor_get()}, {gpu.platform.renderer_get()}, {gpu.platform.version_get()}"


def _installed() -> str:
    facts = runtime_install.installed_facts(Path(compat.user_folder("")))
    return ", ".join(f"{name} {value}" for name, value in facts.items()) or "none"


def _without_home(text: str) -> str:
    home = str(Path.home())
    return text.replace(home, "~") if len(home) > 1 else text
