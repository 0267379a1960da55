"""Translations of labels into German, French, Spanish, Simplified Chinese and Japanese.

`translations.json` has one row for each message of panels and operators, in the order of its `locales`; Blender shows the
column of the user's language and the English text where a message is missing. Names of expressions stay English.
"""

from __future__ import annotations

import json
from pathlib import Path

import bpy

CONTEXTS = ("*", "Operator")
"""Blender looks labels of operators up in a context of their own."""
CLASSES = ()


def table() -> dict[str, dict[tuple[str, str], str]]:
    """Return the messages as `bpy.app.translations` takes them: locale, then context and message."""
    stored = json.loads(Path(__file__).with_suffix(".json").read_text("utf-8"))
    return {
        locale: {(context, message): row[column] for message, row in stored["messages"].items() for context in CONTEXTS}
        for column, locale in enumerate(stored["locales"])
    }


def register() -> None:
    """Hand the table to Blender."""
    bpy.app.translations.register(__name__, table())


def unregister() -> None:
    """Take it back."""
    bpy.app.translations.unregister(__name__)
