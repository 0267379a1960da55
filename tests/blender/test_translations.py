"""The table of translations: complete, of messages that exist, and taken back as it was given."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest
from blender_process import RunBlender

ROOT = Path(__file__).resolve().parents[2]


def _table() -> dict[str, list[str]]:
    return json.loads((ROOT / "grmm_blender" / "translations.json").read_text("utf-8"))["messages"]


def _strings() -> set[str]:
    """Every string of the user interface's source."""
    found: set[str] = set()
    for folder in ("grmm_blender", "operators", "grmm_core/controls"):
        for path in (ROOT / folder).rglob("*.py"):
            constants = (node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Constant))
            found |= {node.value for node in constants if isinstance(node.value, str)}
    return found


def test_every_message_is_in_the_interface():
    missing = set(_table()) - _strings()
    assert missing == set()


def test_every_row_has_five_languages_in_their_scripts():
    for message, row in _table().items():
        assert len(row) == 5, message
        assert all(text.strip() == text and text for text in row), message
        assert all(text.endswith("...") == message.endswith("...") for text in row), message
        german, french, spanish, chinese, japanese = row
        assert re.search(r"[\u4e00-\u9fff]", chinese), message
        assert re.search(r"[\u3040-\u30ff\u4e00-\u9fff]", japanese), message
        assert not re.search(r"[\u3040-\u30ff\u4e00-\u9fff]", german + french + spanish), message


def test_operators_of_ours_are_translated():
    table = _table()
    for topic in ("composite", "contact_sheet", "pose_library", "turntable", "edit"):
        source = (ROOT / "operators" / f"{topic}.py").read_text("utf-8")
        labels = re.findall(r'bl_label = "(.+)"', source)
        assert labels
        assert [label for label in labels if label not in table] == [], topic


@pytest.mark.blender
def test_registering_is_clean(run_blender: RunBlender, blender_version: str):
    result = run_blender("translations_table.py", python=blender_version, fresh=True).result
    assert result["locales"] == ["de_DE", "es", "fr_FR", "ja_JP", "zh_HANS"]
    assert result["sizes"] == [2 * len(_table())] * 5
    assert result["contexts"] == ["*", "Operator"]
    assert result["hooked"]
    assert result["left"] == []
