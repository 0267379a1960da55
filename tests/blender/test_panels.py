"""The panels: what they show with and without an avatar, and that everything named in them exists."""

from __future__ import annotations

import pytest
from blender_process import RunBlender

from grmm_core.controls.names import EXPRESSION_NAMES

pytestmark = pytest.mark.blender


def test_every_slider_of_the_selected_avatar_is_drawn_once(run_blender: RunBlender, blender_version: str):
    result = run_blender("panels_draw.py", python=blender_version).result
    without, head = result["without"], result["head"]
    assert without["panels"] == ["GRMM_PT_avatar"]
    assert "grmm.add_head" in without["operators"]
    drawn = [path for path in head["properties"] if path.startswith('["')]
    for name in EXPRESSION_NAMES:
        assert drawn.count(f'["{name}"]') == 2, name  # the sidebar's panel and its twin in the data tab
    assert any(path == "rotation_euler[0]" for path in head["properties"])
    assert "grmm.import_performance" in head["operators"]
    edits = {"grmm.reset", "grmm.mirror", "grmm.random_expression", "grmm.random_detail"}
    edits |= {"grmm.save_code", "grmm.calibrate_neutral"}
    assert edits <= set(head["operators"])
    # Also where no runtime could find out that the file is gone.
    assert "grmm.relink_avatar" not in head["operators"]
    assert "gone.grmm does not exist; choose the file again with Relink Avatar" in result["missing"]["text"]
    assert "grmm.relink_avatar" in result["missing"]["operators"]
    assert len(result["registered"]) >= 2 * 5


def test_a_narrow_sidebar_has_every_slider_under_a_name_that_fits(run_blender: RunBlender, blender_version: str):
    result = run_blender("panels_draw.py", python=blender_version).result
    narrow, head = result["narrow"], result["head"]
    assert narrow["properties"] == head["properties"]
    assert sorted(narrow["operators"]) == sorted(head["operators"])
    sliders = [path for path in narrow["properties"] if path.startswith('["') and path.endswith('"]')]
    names = dict(zip(sliders, narrow["names"], strict=True))
    expressions = [names[f'["{name}"]'] for name in EXPRESSION_NAMES]
    assert len(set(expressions)) == len(EXPRESSION_NAMES)
    assert max(map(len, expressions)) <= 17
    assert max(map(len, narrow["labels"])) <= 30
