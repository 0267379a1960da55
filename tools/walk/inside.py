"""Inside Blender: `blender --python tools/walk/inside.py -- FOLDER` runs snippets that appear in the folder, in the window.

A snippet N.py is run once by a timer, with `window`, `area`, `region` of the largest 3D viewport at hand. What it leaves in
`result` goes to N.json, or its traceback does. Needs nothing of the project, so that it runs where only the zip is installed.
"""

from __future__ import annotations

import json
import sys
import traceback
from pathlib import Path
from typing import Any

import bpy

sys.path.append(str(Path(__file__).parent))
from waits import Watch  # beside this file, wherever that was copied to

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
POLL_SECONDS = 0.1


def viewport() -> dict[str, Any]:
    """The window, its largest 3D viewport and that viewport's region, as names for a snippet."""
    window = bpy.context.window_manager.windows[0]
    areas = [area for area in window.screen.areas if area.type == "VIEW_3D"]
    area = max(areas, key=lambda found: found.width * found.height, default=window.screen.areas[0])
    return {"window": window, "area": area, "region": next(part for part in area.regions if part.type == "WINDOW")}


def poll() -> float:
    """Run what has come; asked by Blender's timer."""
    for path in sorted(FOLDER.glob("*.py")):
        names = {"bpy": bpy, "result": None, **viewport()}
        try:
            with bpy.context.temp_override(window=names["window"], area=names["area"], region=names["region"]):
                exec(compile(path.read_text("utf-8"), path.name, "exec"), names)
            answer = {"result": names["result"]}
        except Exception:  # noqa: BLE001 - whatever it is, the walk has to hear of it
            answer = {"error": traceback.format_exc()}
        path.unlink()
        temporary = path.with_suffix(".tmp")
        temporary.write_text(json.dumps(answer, default=str), "utf-8")
        temporary.rename(path.with_suffix(".json"))
    return POLL_SECONDS


Watch(FOLDER.parent / "waits.txt").start()
bpy.app.timers.register(poll, first_interval=1.0, persistent=True)
