"""Install a zip as a user does: install.py ZIP."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from support import MODULE, report

bpy.ops.extensions.package_install_files(filepath=str(Path(sys.argv[1]).resolve()), repo="user_default", enable_on_install=True)
report(enabled=MODULE in bpy.context.preferences.addons)
assert MODULE in bpy.context.preferences.addons
