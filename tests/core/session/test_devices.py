"""Whether torch could compute on a graphics card, told without importing it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ASK = "import sys; from grmm_core.compute.devices import has_card; print(has_card(), 'torch' in sys.modules)"
CARD = (
    "cuda = type('cuda', (), {'is_available': staticmethod(lambda: True)}); device = lambda kind: type('', (), {'type': kind})"
)


@pytest.mark.parametrize(
    ("version", "answer"),
    [
        ("cuda = None\nhip = None\n", "False False"),
        ("cuda = '12.8'\n", "True True"),
        ("hip = '6.4'\n", "True True"),
        (None, "True True"),
    ],
)
def test_torch_is_imported_only_where_it_was_built_for_cards(
    version: str | None, answer: str, repository: Path, tmp_path: Path
):
    package = tmp_path / "torch"
    package.mkdir()
    (package / "__init__.py").write_text(CARD)
    if version is not None:
        (package / "version.py").write_text(version)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(repository)))}
    done = subprocess.run(
        [sys.executable, "-c", ASK], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == answer
