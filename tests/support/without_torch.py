"""Run a script in a process where importing torch fails."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_TIMEOUT = 300.0  # seconds; kernels may compile


def run_without_torch(script: str, folder: Path) -> None:
    """Run indented Python text in `folder`, with this project on the path and no torch; its errors fail the test."""
    code = 'import sys\nsys.modules["torch"] = None\n' + textwrap.dedent(script)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, check=True, timeout=_TIMEOUT)
