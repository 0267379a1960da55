"""Shared fixtures. The repository root is on the path, so that `grmm_core` and `grmm_studio` import without an install."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import blender_version, run_blender  # noqa: F401  fixtures

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))


@pytest.fixture(scope="session")
def repository() -> Path:
    return ROOT
