"""Run scripts in Blender with the built extension installed: the `run_blender` fixture.

Each script of `tests/blender/scripts/` runs in a process of its own, in the interpreter of the tests ("4.5", the bpy wheel
beside pytest) or in that of Blender 5.2 ("5.2": environment variable GRMM_BPY52_PYTHON, else `.venv52`). The zip is built
once per test run and installed once per interpreter into a Blender user folder that starts empty. Where a bpy is missing, the
test skips and says so.

    def test_something(run_blender, tmp_path):
        done = run_blender("my_script.py", tmp_path / "out.png")
        assert done.result["answer"] == 42

The script reads its arguments from `sys.argv[1:]` and hands values back with `support.report(answer=42)`.
"""

from __future__ import annotations

import atexit
import functools
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from kept_kernels import keep_kernels, lend_kernels

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = ROOT / "tests" / "blender" / "scripts"
PYTHON_52_VARIABLE = "GRMM_BPY52_PYTHON"
EXTENSION = Path("extensions", "user_default", "grmm")  # in a Blender user folder
STOCK = {"4.5": "4.5 alone", "5.2": "5.2"}
"""Blenders with numpy and nothing else; the 4.5 beside pytest has torch, so `.venv45` holds another one."""
DEFAULT_TIMEOUT = 180.0  # seconds; numba may compile for the first time


@dataclass(frozen=True)
class BlenderRun:
    """What a script left: exit code, its output, and what it reported."""

    returncode: int
    stdout: str
    stderr: str
    result: dict[str, Any] = field(default_factory=dict)

    @property
    def output(self) -> str:
        return self.stdout + self.stderr


RunBlender = Callable[..., BlenderRun]


@pytest.fixture(scope="session")
def run_blender() -> RunBlender:
    return _run


@pytest.fixture(params=["4.5", "5.2"])
def blender_version(request: pytest.FixtureRequest) -> str:
    """Each Blender that the extension supports; skips where it is not installed."""
    find_python(request.param)
    return request.param


def find_python(version: str) -> Path:
    """Return the interpreter that has the bpy of a Blender version, or skip the test."""
    if version == "4.5":
        if importlib.util.find_spec("bpy") is None:
            pytest.skip("bpy is not installed beside pytest")
        return Path(sys.executable)
    if version == STOCK["4.5"]:
        python = ROOT / ".venv45" / "bin" / "python"
        if not python.exists():
            pytest.skip("no bpy 4.5 without torch: make .venv45/.ready")
        return python
    named = os.environ.get(PYTHON_52_VARIABLE)
    python = Path(named) if named else ROOT / ".venv52" / "bin" / "python"
    if not python.exists():
        pytest.skip(f"no Python 3.13 with bpy 5.2: set {PYTHON_52_VARIABLE} or make .venv52")
    return python


@functools.cache
def extension_zip() -> Path:
    """Build the extension, once per test run."""
    find_python("4.5")  # the packaging tool is in its wheel
    folder = _temporary_folder()
    done = subprocess.run(
        [sys.executable, "-m", "tools.build_extension", "--output", str(folder)],
        cwd=ROOT, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return Path(done.stdout.strip().splitlines()[-1])


@functools.cache
def user_folder(version: str) -> Path:
    """Install the zip into an empty Blender user folder, once per interpreter and test run."""
    folder = _temporary_folder()
    done = _launch(version, folder, "install.py", [str(extension_zip())], DEFAULT_TIMEOUT, enable=False)
    assert done.returncode == 0, done.output
    lend_kernels(folder / EXTENSION / "grmm_core")
    return folder


def _run(
    script: str | Path,
    *arguments: object,
    python: str = "4.5",
    timeout: float = DEFAULT_TIMEOUT,
    check: bool = True,
    fresh: bool = False,
    enable: bool = True,
    environment: dict[str, str] | None = None,
    edit: Callable[[Path], None] | None = None,
) -> BlenderRun:
    """Run a script in Blender with the extension enabled.

    Args:
        script: File name in `tests/blender/scripts/`, or a path.
        arguments: Become `sys.argv[1:]`.
        python: Blender version, "4.5" or "5.2".
        timeout: Seconds until the process is killed and the test fails.
        check: Fail the test when the script exits with anything but 0.
        fresh: Use a copy of the user folder, so that the script may disable or remove the extension.
        enable: Enable the extension before the script runs.
        environment: Further environment variables.
        edit: Changes the files of the installed extension, whose folder it is given, in a copy of the user folder.
    """
    folder = user_folder(version=python)
    if fresh or edit:
        copy = _temporary_folder()
        shutil.copytree(folder, copy, dirs_exist_ok=True)
        folder = copy
    lend_kernels(folder / EXTENSION / "grmm_core")
    if edit:
        edit(folder / EXTENSION)
    done = _launch(python, folder, script, [str(a) for a in arguments], timeout, enable, environment)
    if not edit:  # what is compiled of changed files is nobody else's
        keep_kernels(folder / EXTENSION / "grmm_core")
    if check:
        assert done.returncode == 0, f"{script} exited with {done.returncode}:\n{done.output}"
    return done


def run_alone(script: str, *arguments: object, python: str, timeout: float = 2 * DEFAULT_TIMEOUT) -> BlenderRun:
    """Run a script in a Blender with an empty user folder, without the extension."""
    done = _launch(python, _temporary_folder(), script, [str(a) for a in arguments], timeout, enable=False)
    assert done.returncode == 0, done.output
    return done


def _launch(
    version: str,
    folder: Path,
    script: str | Path,
    arguments: list[str],
    timeout: float,
    enable: bool,
    environment: dict[str, str] | None = None,
) -> BlenderRun:
    result = folder / "result.json"
    result.unlink(missing_ok=True)
    variables = {
        **{k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "BLENDER_"))},
        "BLENDER_USER_RESOURCES": str(folder),
        "GRMM_TEST_RESULT": str(result),
        "GRMM_TEST_ENABLE": "1" if enable else "",
        "PYTHONUNBUFFERED": "1",
        **(environment or {}),
    }
    command = [str(find_python(version)), "-X", "faulthandler", str(SCRIPTS / "launcher.py"), str(SCRIPTS / script), *arguments]
    try:
        done = subprocess.run(
            command, cwd=folder, env=variables, capture_output=True, text=True, errors="replace", timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired as error:
        pytest.fail(f"{script} did not end within {timeout} s:\n{_text(error.stdout)}\n{_text(error.stderr)}")
    reported = json.loads(result.read_text("utf-8")) if result.exists() else {}
    return BlenderRun(done.returncode, done.stdout, done.stderr, reported)


def _text(data: bytes | str | None) -> str:
    return data.decode(errors="replace") if isinstance(data, bytes) else data or ""


def _temporary_folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="grmm-blender-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
