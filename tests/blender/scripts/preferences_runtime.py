"""Install, use, replace and remove a runtime from a folder of wheels: preferences_runtime.py WHEELS EMPTY_FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from support import module, report

wheels, empty = sys.argv[1:3]
preferences = module("grmm_blender.preferences")
host = module("grmm_blender.session_host")
install = module("grmm_blender.runtime_install")
settings = preferences.get()
folder = Path(module("grmm_blender.compat").user_folder(""))


def attempt(**options: object) -> str:
    try:
        bpy.ops.grmm.install_runtime(**options)
    except RuntimeError as error:
        return str(error)
    return ""


def there() -> list[str]:
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


bpy.context.preferences.system.use_online_access = False
report(online=bpy.app.online_access, offline_poll=bpy.ops.grmm.install_runtime.poll())
settings.wheels = empty
report(empty=attempt(wait=True), after_empty=there())
settings.wheels = empty + "/nowhere"
report(no_folder=attempt(wait=True))

settings.wheels = wheels
settings.install_python = empty + "/python"
report(no_python=attempt(wait=True))
settings.install_python = ""

report(cancel_start=attempt())
job = preferences._job
bpy.ops.grmm.cancel_runtime()
report(cancelled=job.wait(60), cancel_message=job.error, after_cancel=there())

report(installed=attempt(wait=True), after_install=there(), progress=preferences._job.progress.fraction)
report(facts=install.installed_facts(folder), python=host.settings().python, found=Path(host.settings().python).exists())
report(diagnostics=module("grmm_blender.diagnostics").report(), home=str(Path.home()))
settings.device, settings.threads, settings.runtime = "cpu", 3, "worker"
report(settings=[host.settings().device, host.settings().threads, host.settings().mode])

overlay, view = module("grmm_blender.viewport.overlay"), module("grmm_blender.engine.view")
renderer = view.ViewRenderer()
renderer._error, overlay._viewports[1] = "The model needs torch.", overlay.Viewport()
settings.worker_python = empty + "/python"
status = host.runtime_status()
report(missing=[status.available, status.message], tried_again=[renderer._error, len(overlay._viewports)])
settings.runtime, settings.worker_python = "auto", sys.executable
report(named=list(host.choose_runtime(host.settings())), executable=sys.executable)
settings.runtime = "worker"
settings.worker_python = ""
report(found_again=host.runtime_status().available)
bpy.ops.grmm.remove_runtime()
report(after_remove=there(), python_after_remove=host.settings().python)
