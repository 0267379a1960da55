"""Shared fixtures. The repository root is on the path, so that `grmm_core` and `grmm_studio` import without an install."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from blender_process import blender_version, run_blender  # noqa: F401  fixtures

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))


@pytest.fixture(scope="session")
def repository() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def photo_file() -> Callable[[str], Path]:
    """Path of a test photo by the start of its name, such as "p01"; skips where the photos are not beside this checkout."""
    folder = ROOT.parent / "shared" / "photos"
    if not folder.is_dir():
        pytest.skip("the test photos are not beside this checkout")
    return lambda name: next(folder.glob(f"{name}_*"))
