"""Check the types of the core, the extension, the studio and the tools with mypy: `python -m tools.check_types`.

The extension reaches the core relatively, from a root package to which Blender gives its name; mypy goes by the names of
folders. So it looks at the extension through a link called `grmm`, whatever the checkout is called. `make lint` calls this.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LINK = ROOT / ".mypy_cache" / "packages" / "grmm"  # a hidden folder: what walks the checkout leaves it out
PACKAGES = ("grmm_core", "grmm_studio", "tools", "grmm.grmm_blender", "grmm.operators")


def main() -> int:
    """Run mypy on all packages, print what it finds by the files' own paths, and return its exit code."""
    LINK.parent.mkdir(parents=True, exist_ok=True)
    if not LINK.is_symlink():
        LINK.symlink_to(os.path.relpath(ROOT, LINK.parent), target_is_directory=True)
    command = [sys.executable, "-m", "mypy", *(word for package in PACKAGES for word in ("--package", package))]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    print(done.stdout.replace(f"{LINK.relative_to(ROOT)}{os.sep}", ""), end="")
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
