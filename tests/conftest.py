"""Shared fixtures.

The repository root is on the path, so that `grmm_core` and `grmm_studio` import without an install, and `tests/support`,
whose modules make small models, heads and files for many tests.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from blender_process import blender_version, run_blender  # noqa: F401  fixtures

if TYPE_CHECKING:
    from grmm_core.session import Session

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]


# One file of Blender's first, which compiles the kernels that all of them need, while other processes are at tests without
# Blender; then what takes longest, so that none of it is left to one process alone at the end.
ORDER = ("blender/test_blender_export.py", "core/fitting", "blender", "studio", "core/session", "core/training", "")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def place(item: pytest.Item) -> int:
        name = item.path.relative_to(ROOT / "tests").as_posix()
        return next(number for number, begin in enumerate(ORDER) if name.startswith(begin))

    items.sort(key=place)


@pytest.fixture(scope="session")
def repository() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def photo_file() -> Callable[[str], Path]:
    """Path of a photo of `tests/data/photos` by its name: "astronaut" or "admiral"."""
    return lambda name: ROOT / "tests" / "data" / "photos" / f"{name}.jpg"


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random weights of the tiny configuration on the open head."""
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture(scope="module")
def local(weights: Path) -> Iterator[Session]:
    """A session in this process, with the tiny weights and the reference of all engines."""
    from grmm_core.session import create_session

    with create_session("local", weights=weights, device="cpu", threads=1, engine="torch") as session:
        yield session
