"""The panels: what they show with and without an avatar, and that everything named in them exists."""

from __future__ import annotations

import pytest
from blender_process import RunBlender

from grmm_core.controls.control import without_side
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


def test_a_narrow_sidebar_has_every_row_under_a_name_that_fits(run_blender: RunBlender, blender_version: str):
    result = run_blender("panels_draw.py", python=blender_version).result
    narrow, head = result["narrow"], result["head"]
    assert narrow["properties"] == head["properties"]
    assert sorted(narrow["operators"]) == sorted(head["operators"])
    sliders = [path for path in narrow["properties"] if path.startswith('["') and path.endswith('"]')]
    names = dict(zip(sliders, narrow["names"], strict=True))
    assert names['["mouthUpperUpLeft"]'] == names['["mouthUpperUpRight"]'] == "Upper Lip Up"
    rows = {names[f'["{name}"]'] for name in EXPRESSION_NAMES}
    assert len(rows) == len({without_side(name) for name in EXPRESSION_NAMES})
    assert max(map(len, rows)) <= 15
    assert max(map(len, narrow["labels"])) <= 30


def test_search_shows_what_is_meant_and_nothing_else(run_blender: RunBlender, blender_version: str):
    result = run_blender("panels_draw.py", python=blender_version).result
    lips = ['["mouthUpperUpRight"]', '["mouthUpperUpLeft"]']
    for text, wanted in {
        "lip up": lips,
        "mouthUpperUp": lips,
        "neck": [f"rotation_euler[{axis}]" for axis in range(3)],
    }.items():
        found = result[f"search {text}"]
        assert not [name for name in found["panels"] if "region_" in name]
        assert set(wanted) <= set(found["properties"]), text
        assert '["jawOpen"]' not in found["properties"]
    assert '["browInnerUp"]' not in result["search brow left"]["properties"]
    assert "No control has this name" in result["search no such thing"]["text"]


def test_favourites_are_kept_and_shown(run_blender: RunBlender, blender_version: str):
    result = run_blender("panels_draw.py", python=blender_version).result
    assert result["favourites"] == ["mouthSmileRight", "neck"]
    assert "GRMM_PT_favourites" not in result["head"]["panels"]
    assert "GRMM_PT_favourites" in result["starred"]["panels"]
    assert result["smiles"] == 4  # in its region and among the favourites, in both places
    assert result["starred"]["stars"] > 2 * 30


def test_tooltips_say_what_is_worked_on(run_blender: RunBlender, blender_version: str):
    reset, copy, swap, lid = run_blender("panels_draw.py", python=blender_version).result["tooltips"]
    assert reset.endswith("lips only")
    assert copy == "Copy the subject's left side to the right: brows only"
    assert swap == "Exchange both sides; sideways movements turn round"
    assert lid.startswith("Upper Lid Left (Eyelids). Drag up: Open Wide Left; down: Close Lid Left.")
