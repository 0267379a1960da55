"""Avatars of the library in Blender: added by name, the right mesh, and the same after reopening the file."""

from __future__ import annotations

import pytest
from blender_process import RunBlender, find_python
from tolerances import RIG_PARITY

pytestmark = pytest.mark.blender


# How one is added and reopened is Blender's; which meshes they have is not, and the second Blender need not see all of them.
@pytest.mark.parametrize(("version", "count"), [("4.5", 3), ("5.2", None)])
def test_every_avatar_can_be_added(run_blender: RunBlender, version: str, count: int | None):
    find_python(version)
    added = run_blender("library_add.py", *([count] if count else []), python=version).result
    assert added["menu"]
    assert added["names"][0] == "default"
    sources = [f"library:{name}" for name in added["names"][:count]]
    assert len(added["names"]) > 3
    assert [person["source"] for person in added["people"].values()] == sources
    assert added["reopened"] == sorted(sources)
    assert len({person["object"] for person in added["people"].values()}) == len(sources)
    for person in added["people"].values():
        assert person["parity"] < RIG_PARITY
