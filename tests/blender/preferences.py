"""Set the extension's preferences and report what becomes of them."""

from __future__ import annotations

import sys

import bpy
from support import MODULE, module, report

preferences = bpy.context.preferences.addons[MODULE].preferences
host = module("grmm_blender.session_host")
preferences.mode = "worker"
preferences.python = sys.argv[1]
preferences.device = "cpu"
preferences.threads = 1
report(settings=[host._settings.mode, host._settings.python, host._settings.device, host._settings.threads])
report(before=module("grmm_blender.preferences").diagnostics())
session = host.get_session()
session.open("sample:1")
report(kind=session.status().kind, after=module("grmm_blender.preferences").diagnostics())
preferences.python = sys.argv[1] + "-missing"
try:
    host.get_session().open("sample:1")
except module("grmm_core.errors").GrmmError as error:
    report(message=str(error))
