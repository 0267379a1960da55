"""Install the neural runtime: a Python environment with torch that the worker process uses.

Stock Blender has no torch. This makes a virtual environment beside the extension's user files, from any Python, with pip, from
the package index or from a folder of wheels without network. It grows under a temporary name and gets its own when it has
proved that it works, so that a cancelled or failed installation leaves nothing that could be mistaken for a runtime.

Used by `preferences`; knows no bpy, so that it can run on a thread of its own.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from ..grmm_core.errors import CancelledError, GrmmError, RuntimeMissingError
from ..grmm_core.files.access import describe_os_error
from ..grmm_core.jobs.progress import Progress, Reporter
from ..grmm_core.jobs.stages import INSTALL
from ..grmm_core.session.process import NO_WINDOW, lines_of

REQUIREMENTS = (
    "torch>=2.6,<3", "numba>=0.61,<1", "onnxruntime>=1.20,<2", "numpy>=1.26,<3", "pillow>=10.3,<14", "av>=14,<19",
    "pocketsphinx>=5.0.3,<6; python_version<'3.14'",
)  # fmt: skip
"""What the worker imports; the same as the dependencies of the package `grmm-core`."""
FOLDER = "runtime"
STATE_FILE = "grmm_runtime.json"
_PARTIAL = "runtime.partial"
_LOG_LINES = 400
_USUAL_PACKAGES = 22  # that pip fetches for the requirements on a machine without CUDA; only shapes the progress bar
_CHECK = (
    "import json, platform, av, numpy, numba, onnxruntime, torch, PIL; "
    "torch.zeros(3).sum(); "
    "print(json.dumps({'python': platform.python_version(), 'torch': torch.__version__, 'numba': numba.__version__, "
    "'numpy': numpy.__version__, 'cuda': torch.cuda.is_available()}))"
)
# Present where NVIDIA's driver is: Linux; Windows.
_NVIDIA_FILES = ("/proc/driver/nvidia/version", "/dev/nvidiactl", r"C:\Windows\System32\nvcuda.dll")
# Where Blender's Python is, and where pip would put packages instead of into the environment.
_OF_ANOTHER_PYTHON = (
    "PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "PYTHONEXECUTABLE", "__PYVENV_LAUNCHER__",
    "PIP_TARGET", "PIP_USER", "PIP_PREFIX", "PIP_ROOT",
)  # fmt: skip
# Pip's messages that say more to a user than its last line does.
_KNOWN_FAILURES = (
    (r"No space left on device|Errno 28", "The disk is full; free some gigabytes and try again."),
    (r"Temporary failure in name resolution|Failed to establish a new connection|getaddrinfo failed|Network is unreachable",
     "The package index cannot be reached; check the network, or install from a folder of wheels."),
    (r"No matching distribution found for (\S+)",
     "There is no package {0} for this Python and system; choose another Python, or add its wheel to the folder."),
    (r"No module named (venv|ensurepip)", "The Python {python} cannot make environments (no {0}); choose another Python."),
)  # fmt: skip


@dataclass(frozen=True)
class InstallRequest:
    """What to install and from where.

    Attributes:
        folder: The extension's user folder; the runtime becomes its sub-folder `FOLDER`.
        python: Interpreter to build upon.
        wheels: Folder of wheels to install from without network, or "".
        index: Address of a package index, or "" for pip's own setting.
    """

    folder: Path
    python: str = sys.executable
    wheels: str = ""
    index: str = ""


@dataclass(frozen=True)
class Machine:
    """What a runtime would run on.

    Attributes:
        system: Such as "Linux x86_64".
        accelerator: "CUDA", "Metal", or "" for the processor alone.
        advice: One sentence for people: what an installation fetches.
    """

    system: str
    accelerator: str
    advice: str


@functools.lru_cache(maxsize=1)
def detect_machine() -> Machine:
    """Look at the platform and the graphics driver; starts nothing and asks nobody."""
    system = f"{platform.system()} {platform.machine()}".strip()
    if sys.platform == "darwin":
        metal = "Metal" if platform.machine() == "arm64" else ""
        return Machine(system, metal, "About half a gigabyte is fetched.")
    if any(Path(path).exists() for path in _NVIDIA_FILES) or shutil.which("nvidia-smi") is not None:
        return Machine(system, "CUDA", "Packages with CUDA are fetched, several gigabytes.")
    if sys.platform == "win32":
        return Machine(system, "", "No NVIDIA card was found: the processor is used. About half a gigabyte is fetched.")
    return Machine(
        system, "",
        "No NVIDIA card was found: the processor is used. The usual index has builds with CUDA, several gigabytes; name an "
        "index with builds for processors in the options.",
    )  # fmt: skip


class InstallJob:
    """One installation on a thread of its own. Poll `progress` and `running`; then read `error`."""

    def __init__(self, request: InstallRequest) -> None:
        self._request = request
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._cancelled = False
        self._progress = Progress()
        self._report = Reporter(INSTALL, self._keep)
        self._fetched = 0
        self._log: deque[str] = deque(maxlen=_LOG_LINES)
        self._error = ""
        self._thread = threading.Thread(target=self._run, name="GRMM runtime installation", daemon=True)

    def start(self) -> None:
        """Start; returns at once."""
        self._thread.start()

    def cancel(self) -> None:
        """Stop as soon as possible; what was installed so far is removed."""
        with self._lock:
            self._cancelled = True
            process = self._process
        if process is not None:
            with contextlib.suppress(OSError):
                process.terminate()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for the end; returns whether it came."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._thread.is_alive()

    @property
    def progress(self) -> Progress:
        """Where it stands."""
        with self._lock:
            return self._progress

    @property
    def error(self) -> str:
        """One sentence if it failed or was cancelled, else empty."""
        with self._lock:
            return self._error

    @property
    def log(self) -> str:
        """The last lines of the tools' output."""
        with self._lock:
            return "\n".join(self._log)

    def _run(self) -> None:
        partial = self._request.folder / _PARTIAL
        try:
            self._install(partial)
        except GrmmError as error:
            message = str(error)
        except OSError as error:
            message = f"The runtime cannot be installed in {self._request.folder}: {describe_os_error(error)}."
        else:
            message = ""
        if message:
            shutil.rmtree(partial, ignore_errors=True)
        with self._lock:
            self._error = message

    def _install(self, partial: Path) -> None:
        request = self._request
        self._report("environment", 0.0)
        request.folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(partial, ignore_errors=True)
        self._call([request.python, "-m", "venv", "--clear", str(partial)])
        self._report("download", 0.0, "Looking for packages")
        self._call([environment_python(partial), *pip_arguments(request)], self._follow_pip)
        self._report("check", 0.0)
        facts = self._call([environment_python(partial), "-c", _CHECK]).strip().splitlines()[-1]
        (partial / STATE_FILE).write_text(facts, "utf-8")
        final = request.folder / FOLDER
        if final.exists():
            remove(request.folder)
        partial.rename(final)
        self._report("check", 1.0, "Installed")

    def _call(self, command: list[str], follow: object = None) -> str:
        """Run a tool to its end and return its output. Raises `CancelledError`, `RuntimeMissingError`."""
        with self._lock:
            if self._cancelled:
                raise CancelledError("The installation was cancelled.")
            try:
                process = self._process = subprocess.Popen(
                    command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True,
                    errors="replace", env=tool_environment(self._request), creationflags=NO_WINDOW,
                )  # fmt: skip
            except OSError as error:
                reason = describe_os_error(error)
                raise RuntimeMissingError(f"The Python {command[0]} cannot be started ({reason}); choose another.") from error
        lines = []
        for line in lines_of(process.stdout):
            lines.append(line)
            with self._lock:
                self._log.append(line.rstrip())
            if callable(follow):
                follow(line.strip())
        code = process.wait()
        with self._lock:
            self._process = None
            cancelled = self._cancelled
        if cancelled:
            raise CancelledError("The installation was cancelled.")
        output = "".join(lines)
        if code != 0:
            raise RuntimeMissingError(explain_failure(output, self._request.python))
        return output

    def _follow_pip(self, line: str) -> None:
        if line.startswith("Collecting"):
            self._fetched += 1
            name = re.split(r"[<>=!~;\[ ]", line.removeprefix("Collecting").strip(), maxsplit=1)[0]
            self._report("download", self._fetched / _USUAL_PACKAGES, f"Fetching {name}")
        elif line.startswith("Downloading"):
            size = re.search(r"\(([^)]*)\)", line)
            if size:
                name = self.progress.message.split(" (")[0]
                self._report("download", self._fetched / _USUAL_PACKAGES, f"{name} ({size[1]})")
        elif line.startswith("Installing collected packages"):
            self._report("install", 0.0)

    def _keep(self, progress: Progress) -> None:
        with self._lock:
            self._progress = progress


def pip_arguments(request: InstallRequest) -> list[str]:
    """Return the arguments after the interpreter that install the requirements."""
    arguments = ["-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--progress-bar", "off"]
    if request.wheels:
        arguments += ["--no-index", "--find-links", request.wheels]
    elif request.index:
        arguments += ["--index-url", request.index]
    return [*arguments, *REQUIREMENTS]


def environment_python(environment: Path) -> str:
    """Return the interpreter of a virtual environment."""
    return str(environment / "Scripts" / "python.exe" if os.name == "nt" else environment / "bin" / "python")


def installed_python(folder: Path) -> str:
    """Return the interpreter of the installed runtime, or "" where there is none."""
    python = environment_python(folder / FOLDER)
    return python if Path(python).exists() and (folder / FOLDER / STATE_FILE).exists() else ""


def installed_facts(folder: Path) -> dict[str, object]:
    """Return what the installed runtime said of itself (versions, CUDA), empty where there is none."""
    try:
        facts = json.loads((folder / FOLDER / STATE_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}


def remove(folder: Path) -> None:
    """Delete the installed runtime and what an interrupted installation left.

    Raises:
        RuntimeMissingError: A file is in use or may not be deleted.
    """
    for name in (FOLDER, _PARTIAL):
        target = folder / name
        if not target.exists():
            continue
        try:
            # Renamed first: what is deleted only in part is no runtime any more.
            doomed = target.with_name(f"{name}.removed")
            shutil.rmtree(doomed, ignore_errors=True)
            target.rename(doomed)
            shutil.rmtree(doomed)
        except OSError as error:
            raise RuntimeMissingError(
                f"The runtime in {target} cannot be removed ({describe_os_error(error)}); close what uses it and try again."
            ) from error


def explain_failure(output: str, python: str) -> str:
    """Return one sentence for the failed tool's output."""
    for pattern, message in _KNOWN_FAILURES:
        found = re.search(pattern, output)
        if found:
            return message.format(*found.groups(), python=python)
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR:")] or lines[-1:] or ["no output"]
    return f"The runtime could not be installed ({errors[0].removeprefix('ERROR: ')}); the diagnostics show the whole output."


def tool_environment(request: InstallRequest) -> dict[str, str]:
    """The environment for Python and pip: nothing of Blender's own Python in it.

    A folder of wheels is all that an installation without network uses: the machine's settings for pip (variables, files of
    the user and of the system) could add indexes, other folders and constraints, and are left out. An installation from an
    index needs them, for proxies and mirrors.
    """
    kept = {name: value for name, value in os.environ.items() if name not in _OF_ANOTHER_PYTHON}
    if request.wheels:
        kept = {name: value for name, value in kept.items() if not name.upper().startswith("PIP_")}
        kept["PIP_CONFIG_FILE"] = os.devnull  # pip's own way to read no file at all
    return kept | {"PYTHONUTF8": "1", "PYTHONNOUSERSITE": "1"}
