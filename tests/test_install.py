"""`pip install` of the core and of each of its extras in a clean environment: what an extra is for works with it alone.

Slow, and pip must find the packages: on the network, or where its configuration names folders of wheels.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from import_graph import ROOT

pytestmark = pytest.mark.slow

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
TORCH = "torch==2.13.0"  # first and by its exact version, as in the README: other packages must not bring another one
STUDIO = """
import importlib, pkgutil, grmm_studio
for module in pkgutil.iter_modules(grmm_studio.__path__, "grmm_studio."):
    importlib.import_module(module.name)
"""
PROBES = {
    "head": ["-c", "import tools.open_head.build"],
    "studio": ["-c", STUDIO],
    "train": ["-c", "from torch.utils.tensorboard import SummaryWriter; SummaryWriter('curves').close()"],
    "data": ["-c", "import h5py, av; h5py.File('a.h5', 'w').close()"],
    "exr": ["-c", "import OpenEXR"],
    "cluster": ["-c", "import bokeh; from grmm_core.jobs.cluster import open_cluster\nwith open_cluster('local:1'): pass"],
    "dev": ["-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", str(ROOT / "tests" / "core")],
}
"""What each extra is for; the programs of `tools` and the tests stay in the checkout."""


def run(environment: Path, *arguments: str, timeout: float = 1200.0) -> str:
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    command = [str(environment / "bin" / "python"), *arguments]
    done = subprocess.run(
        command, cwd=environment, env=variables | {"PYTHONPATH": str(environment / "checkout")}, capture_output=True, text=True,
        timeout=timeout, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def install(environment: Path, *packages: str) -> None:
    run(environment, "-m", "pip", "install", "--quiet", "--constraint", str(ROOT / "constraints.txt"), *packages)


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What pip builds from, apart from the checkout: setuptools leaves files beside its sources."""
    folder = tmp_path_factory.mktemp("sources")
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, folder)
    for name in ("grmm_core", "grmm_studio"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


@pytest.fixture(scope="module")
def plain(sources: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the core alone."""
    environment = tmp_path_factory.mktemp("plain")
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True, timeout=300)
    install(environment, TORCH)
    install(environment, str(sources))
    return environment


def test_the_core_draws_without_extras(plain: Path):
    run(plain, "-m", "grmm_core", "render", "default", "-o", "head.png", "--size", "64")
    assert (plain / "head.png").stat().st_size > 1000
    assert "torch" in run(plain, "-m", "grmm_core", "info", "--json")
    engine = "from grmm_core.session import make_local_session as make\nwith make() as session: print(session.status().engine)"
    assert run(plain, "-c", engine).split() == ["plain"]  # the faster one on a CPU


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_brings_all_that_it_needs(extra: str, plain: Path, sources: Path, tmp_path: Path):
    environment = tmp_path / extra
    shutil.copytree(plain, environment, symlinks=True, copy_function=os.link)
    install(environment, f"{sources}[{extra}]")
    if extra in ("head", "dev"):
        (environment / "checkout").symlink_to(ROOT)
    run(environment, *PROBES[extra])
    assert TORCH.replace("==", " ") in " ".join(run(environment, "-m", "pip", "list").split())
