"""The preferences: installing a runtime without network, from wheels made here, in place of several gigabytes."""

from __future__ import annotations

import base64
import hashlib
import tomllib
import zipfile
from pathlib import Path

import pytest
from blender_process import RunBlender, find_python

pytestmark = pytest.mark.blender

FAKES = {
    "torch": "2.6.0",
    "numba": "0.61.0",
    "numpy": "2.0.0",
    "pillow": "11.0.0",
}
TORCH = """
__version__ = "2.6.0"
class zeros:
    def __init__(self, n): pass
    def sum(self): return 0
class cuda:
    is_available = staticmethod(lambda: False)
"""


def write_wheel(folder: Path, name: str, version: str) -> None:
    """Write a wheel with one module that knows its version."""
    module = {"pillow": "PIL"}.get(name, name)
    info = f"{name}-{version}.dist-info"
    files = {
        f"{module}.py": TORCH if name == "torch" else f"__version__ = {version!r}\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = []
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as archive:
        for path, text in files.items():
            digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
            record.append(f"{path},sha256={digest},{len(text)}")
            archive.writestr(path, text)
        archive.writestr(f"{info}/RECORD", "\n".join([*record, f"{info}/RECORD,,"]) + "\n")


@pytest.mark.parametrize("version", ["4.5", pytest.param("5.2", marks=pytest.mark.slow)])
def test_runtime_from_wheels(run_blender: RunBlender, version: str, tmp_path: Path):
    find_python(version)
    wheels, empty = tmp_path / "wheels", tmp_path / "empty"
    wheels.mkdir()
    empty.mkdir()
    for name, version in FAKES.items():
        write_wheel(wheels, name, version)
    result = run_blender("preferences_runtime.py", wheels, empty, python=version, fresh=True).result
    assert result["online"] is False
    assert result["offline_poll"] is False
    assert "There is no package" in result["empty"]
    assert result["after_empty"] == []
    assert "is not a folder" in result["no_folder"]
    assert "cannot be started" in result["no_python"]
    assert result["cancelled"] is True
    assert "cancelled" in result["cancel_message"]
    assert result["after_cancel"] == []
    assert result["installed"] == ""
    assert result["after_install"] == ["runtime"]
    assert result["facts"]["torch"] == "2.6.0"
    assert result["found"]
    assert "runtime" in result["python"]
    assert result["progress"] == 1.0
    assert "torch 2.6.0" in result["diagnostics"]
    assert "Machine: " in result["diagnostics"]
    assert result["home"] not in result["diagnostics"]
    assert result["settings"] == ["cpu", 3, "worker"]
    assert result["after_remove"] == []
    assert result["python_after_remove"] == ""


def test_requirements_are_those_of_the_package(repository: Path):
    text = (repository / "grmm_blender" / "runtime_install.py").read_text("utf-8")
    line = next(line for line in text.splitlines() if line.startswith("REQUIREMENTS"))
    wanted = tomllib.loads((repository / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    assert set(eval(line.partition("=")[2])) == set(wanted)  # a tuple of strings out of our own source
