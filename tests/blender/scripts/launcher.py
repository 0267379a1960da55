"""Start Blender as a module, enable the installed extension, run one script: launcher.py SCRIPT [ARGUMENTS...].

Started by `tests/blender_process.py`. Python's exit handlers run as in any Blender, ours among them. Then the process ends
at once: the bpy wheel was seen waiting forever in a destructor of its own (GlobalState, on whose condition variable the
thread delayed_close_thread_run still waits), three times in some hundred runs.
"""

from __future__ import annotations

import atexit
import os
import runpy
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent)  # for `support`; never the repository, so that only the zip is tested
import bpy  # noqa: E402, F401
import support  # noqa: E402


def main() -> None:
    if os.environ.get("GRMM_TEST_ENABLE"):
        support.enable()
    del sys.argv[0]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)
