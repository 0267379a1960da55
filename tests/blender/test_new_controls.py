"""A control that is added to the core's table is everywhere in Blender, also on heads of files from before."""

from __future__ import annotations

from pathlib import Path

import pytest
from blender_process import RunBlender, find_python
from tolerances import RIG_PARITY
from worked_examples import apply_diff, apply_diffs, chapters

from grmm_core.controls.names import EXPRESSION_NAMES

pytestmark = pytest.mark.blender

SECTION_AND_SLIDER = """+++ grmm_core/controls/table.py
     Section("DETAIL", "Learned Detail", "Residual expression, its saved codes, and strength"),
+    Section("LIGHT", "Light", "How light falls on the skin"),
 )
@@
         Limits(0.0, 1.0, 0.0, 1.0), "share",
     ))  # fmt: skip
+    light_gloss: float = field(default=0.5, metadata=_row(
+        "Skin Gloss", "How much the skin shines", "LIGHT", Limits(0.0, 2.0, 0.0, 1.0), "share", name="light.gloss",
+    ))  # fmt: skip
"""


def add_controls(extension: Path) -> None:
    apply_diff(SECTION_AND_SLIDER, extension)
    apply_diffs(next(chapter for chapter in chapters() if chapter.title == "How to add an expression"), extension)


@pytest.mark.parametrize("version", ["4.5", pytest.param("5.2", marks=pytest.mark.slow)])
def test_a_row_is_all_that_a_control_needs(run_blender: RunBlender, version: str, tmp_path: Path):
    find_python(version)
    file = tmp_path / "before.blend"
    run_blender("save_head.py", file, python=version)
    result = run_blender("new_controls.py", file, python=version, edit=add_controls).result
    assert result["old_values"] == [0.25, 0.5]
    for head in ("old", "new"):
        state = result[head]
        assert state["present"] == [True, True]
        assert state["limits"] == [0.0, 2.0, 1.0, 0.5]
        assert state["moved"] > 1e-3
        on_mesh, wanted = state["gains"]
        assert on_mesh == pytest.approx(wanted, abs=1e-3)
        assert max(wanted[:2]) < 0.99 < 1.01 < wanted[2], "sculpted blinks go too far, and sculpted lips not far enough"
        assert state["parity"] < RIG_PARITY
        assert state["frames"] == 3
        assert state["gloss"] == 0.75
        assert state["valid"]
    assert result["reset"] == [0.7, 0.5, 0.0]
    assert result["rows"] == {"visemeMM": "Viseme MM", "light.gloss": "Skin Gloss"}
    assert {"GRMM_PT_light", "GRMM_PT_data_light"} <= set(result["panels"])
    assert result["random"] > 0.0
    assert result["posed"] == pytest.approx(0.5)
    assert result["defines"] == len(EXPRESSION_NAMES) + 1
    assert result["animated"] == [0.0, 0.5, 1.0]
