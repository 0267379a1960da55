"""The panels: what they show with and without an avatar, and that everything named in them exists."""

from __future__ import annotations

import pytest
from blender_process import RunBlender

from grmm_core.expressions import ALIGNED_NAMES

pytestmark = pytest.mark.blender


def test_every_slider_of_the_selected_avatar_is_drawn_once(run_blender: RunBlender, blender_version: str):
    result = run_blender("panels_draw.py", python=blender_version).result
    without, head = result["without"], result["head"]
    assert without["panels"] == ["GRMM_PT_avatar"]
    assert "grmm.add_head" in without["operators"]
    drawn = [path for path in head["properties"] if path.startswith('["')]
    for name in ALIGNED_NAMES:
        assert drawn.count(f'["{name}"]') == 2, name  # the sidebar's panel and its twin in the data tab
    assert any(path == "rotation_euler[0]" for path in head["properties"])
    assert "grmm.import_performance" in head["operators"]
    edits = {"grmm.reset", "grmm.mirror", "grmm.random_expression", "grmm.random_detail"}
    edits |= {"grmm.save_code", "grmm.calibrate_neutral"}
    assert edits <= set(head["operators"])
    assert len(result["registered"]) >= 2 * 5
