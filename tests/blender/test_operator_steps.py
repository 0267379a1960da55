"""Operators that take a while: progress, Escape, errors on either thread, and straight through in scripts."""

from __future__ import annotations

import pytest
from blender_process import RunBlender

pytestmark = pytest.mark.blender


def test_long_operators(run_blender: RunBlender, blender_version: str):
    found = run_blender("operator_steps.py", python=blender_version).result
    asked = found["asked"]
    assert asked["window"]
    assert asked["result"] == ["FINISHED"]
    assert asked["calls"] == [[True, "chosen.txt"], [True, ""]]
    assert asked["refused"] == "Error: No file is chosen."  # and no traceback of ours
    done = found["finished"]
    assert done["results"] == ["RUNNING_MODAL", "RUNNING_MODAL", "PASS_THROUGH", "PASS_THROUGH", "FINISHED"]
    assert done["said"] == [["INFO", "done value"]]
    assert done["log"] == [False, "value", "closed"]
    progress = [entry for entry in done["shown"] if isinstance(entry, float)]
    assert progress == [0.25, 0.5, 0.75]
    assert "Job: second (50%). Esc cancels" in done["shown"]
    assert done["shown"][-2:] == ["end", None]
    assert done["timers"] == 0

    assert found["cancelled"]["result"] == ["CANCELLED"]
    assert found["cancelled"]["stopped"]
    assert found["cancelled"]["log"][-1] == "closed"
    assert found["cancelled"]["said"][0][0] == "WARNING"
    assert found["cancelled"]["timers"] == 0

    for where, message in (("here", "No room."), ("thread", "The model worker ended.")):
        failed = found[where]
        assert failed["result"] == ["CANCELLED"], where
        assert failed["said"] == [["ERROR", message]], where
        assert failed["log"] == "closed", where
        assert failed["timers"] == 0, where

    # Blender crashes on the handler of an operator that has ended before it was handed over.
    assert found["at_once"] == {"result": ["CANCELLED"], "said": [["ERROR", "No folder."]], "handlers": 0, "timers": 0}

    assert found["walking"] == {"swallowed": ["RUNNING_MODAL"], "last": ["FINISHED"], "log": [False]}
    assert found["replaces"] == {
        "asked": ["INTERFACE"], "shown": ["operator_steps.py and 1 more in scripts will be replaced."], "waits": [0, 0],
        "then": ["RUNNING_MODAL"],
    }  # fmt: skip

    assert found["script"] == {"result": ["FINISHED"], "said": [["INFO", "done value"]], "log": [True, "value", "closed"]}
    assert found["script_fails"]["result"] == ["CANCELLED"]
    assert found["script_fails"]["said"] == [["ERROR", "The model worker ended."]]
