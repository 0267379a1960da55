"""The preferences: installing a runtime without network, from wheels made here, in place of several gigabytes."""

from __future__ import annotations

import ast
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
    "onnxruntime": "1.20.0",
    "av": "14.0.0",
    "pocketsphinx": "5.0.3",
    "numpy": "2.0.0",
    "pillow": "11.0.0",
}
NEWER = {
    "torch": "2.9.0", "numba": "0.63.0", "onnxruntime": "1.30.0", "av": "18.0.0", "pocketsphinx": "5.1.0", "numpy": "2.2.0",
    "pillow": "12.0.0",
}  # fmt: skip
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


def hostile_settings(folder: Path) -> dict[str, str]:
    """Settings for pip as machines have them, which would spoil an installation from a folder of wheels.

    Other packages of the same names, a constraint that none meets, an index that nobody serves, another target; by variables
    and by a file where pip looks for that of the user.
    """
    others, constraints = folder / "others", folder / "constraints.txt"
    (folder / "pip").mkdir(parents=True)
    others.mkdir()
    for name in FAKES:
        write_wheel(others, name, NEWER[name])
    constraints.write_text("numpy==1.0\ntorch==1.0\n")
    index = "http://127.0.0.1:9/simple"
    (folder / "pip" / "pip.conf").write_text(
        f"[global]\nextra-index-url = {index}\nfind-links = {others}\nconstraint = {constraints}\n"
        f"target = {folder / 'elsewhere'}\n[install]\nrequire-hashes = true\n"
    )
    return {
        "XDG_CONFIG_HOME": str(folder), "PIP_FIND_LINKS": str(others), "PIP_CONSTRAINT": str(constraints),
        "PIP_EXTRA_INDEX_URL": index, "PIP_INDEX_URL": index, "PIP_REQUIRE_HASHES": "1", "PIP_DRY_RUN": "1", "PIP_PRE": "1",
        "PIP_TARGET": str(folder / "elsewhere"),
    }  # fmt: skip


@pytest.mark.parametrize("version", ["4.5", pytest.param("5.2", marks=pytest.mark.slow)])
def test_runtime_from_wheels(run_blender: RunBlender, version: str, tmp_path: Path):
    find_python(version)
    wheels, empty, settings = tmp_path / "wheels", tmp_path / "empty", tmp_path / "settings"
    wheels.mkdir()
    empty.mkdir()
    for name, number in FAKES.items():
        write_wheel(wheels, name, number)
    hostile = hostile_settings(settings)
    done = run_blender("preferences_runtime.py", wheels, empty, python=version, fresh=True, environment=hostile)
    result = done.result
    assert not (settings / "elsewhere").exists()
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
    assert result["facts"]["numpy"] == FAKES["numpy"]
    assert result["found"]
    assert "runtime" in result["python"]
    assert result["progress"] == 1.0
    assert "torch 2.6.0" in result["diagnostics"]
    assert "Machine: " in result["diagnostics"]
    assert result["home"] not in result["diagnostics"]
    assert result["settings"] == ["cpu", 3, "worker"]
    assert result["missing"][0] is False
    assert "There is no Python at" in result["missing"][1]
    assert result["tried_again"] == ["", 0], "viewports that met an error ask again"
    assert result["named"] == ["worker", result["executable"]], "the Python that the user names comes first"
    assert result["found_again"]
    assert result["after_remove"] == []
    assert result["python_after_remove"] == ""


def test_requirements_are_those_of_the_package(repository: Path):
    text = (repository / "grmm_blender" / "runtime_install.py").read_text("utf-8")
    names = (node for node in ast.parse(text).body if isinstance(node, ast.Assign))
    stated = next(node.value for node in names if getattr(node.targets[0], "id", "") == "REQUIREMENTS")
    wanted = tomllib.loads((repository / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    assert set(ast.literal_eval(stated)) == set(wanted)
