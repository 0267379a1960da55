"""Registering of translations: translations_table.py. Blender's wheels have no languages, so what it is told is recorded."""

from __future__ import annotations

import sys
from types import SimpleNamespace

from support import MODULE, module, report

translations = module("grmm_blender.translations")
held: dict[str, dict] = {}
translations.bpy = SimpleNamespace(
    app=SimpleNamespace(translations=SimpleNamespace(register=held.__setitem__, unregister=held.__delitem__))
)
translations.register()
table = held[translations.__name__]
report(
    locales=sorted(table),
    sizes=[len(rows) for rows in table.values()],
    contexts=sorted({context for rows in table.values() for context, _ in rows}),
    hooked=translations.__name__ in [f"{MODULE}{name}" for name in sys.modules[MODULE].MODULES],
)
translations.unregister()
report(left=list(held))
