"""Avatars of the library in Blender: added by name, the right mesh, and the same after reopening the file."""

from __future__ import annotations

import pytest
from blender_process import RunBlender, find_python
from tolerances import RIG_PARITY

pytestmark = pytest.mark.blender


@pytest.mark.parametrize("version", ["4.5", "5.2"])
def test_every_avatar_can_be_added(run_blender: RunBlender, version: str):
    find_python(version)
    added = run_blender("library_add.py", python=version).result
    assert added["menu"]
    assert added["names"][0] == "default"
    sources = [f"library:{name}" for name in added["names"]]
    assert [person["source"] for person in added["people"].values()] == sources
    assert added["reopened"] == sorted(sources)
    assert len({person["object"] for person in added["people"].values()}) == len(sources)
    for person in added["people"].values():
        assert person["parity"] < RIG_PARITY
