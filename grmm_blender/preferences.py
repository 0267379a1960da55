"""The extension's preferences: what runs the model, installing a runtime, diagnostics.

Values reach other threads through `session_host.configure` only.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import bpy

from ..grmm_core.errors import GrmmError
from ..grmm_core.jobs.stages import INSTALL
from . import compat, diagnostics, runtime_install, session_host, windows
from .declare import Operator, choice, flag, text, whole
from .progress_bar import draw_progress
from .width import draw_text

_POLL_SECONDS = 0.25
OFFLINE = "Online access is off in Preferences > System; a folder of wheels needs none"

_job: runtime_install.InstallJob | None = None


def _apply(preferences: GRMM_AddonPreferences | SimpleNamespace, renewed: bool = False) -> None:
    """Hand the values to the session host; `renewed` as there."""
    python = bpy.path.abspath(preferences.worker_python) if preferences.worker_python else ""
    settings = session_host.RuntimeSettings(
        mode=preferences.runtime,
        python=python or runtime_install.installed_python(_folder()),
        device=preferences.device,
        threads=preferences.threads,
        weights=bpy.path.abspath(preferences.weights) if preferences.weights else "",
    )
    session_host.configure(settings, renewed)


def _on_edit(preferences: GRMM_AddonPreferences, _context: bpy.types.Context) -> None:
    _apply(preferences)


class GRMM_AddonPreferences(bpy.types.AddonPreferences):
    """Preferences of the extension."""

    bl_idname = compat.ROOT_PACKAGE

    runtime: choice(
        "Run the Model",
        "Where the neural model runs",
        ("auto", "Automatic", "In Blender where its Python has torch, else in a worker process"),
        ("local", "In Blender", "In Blender's own Python, which needs torch"),
        ("worker", "In a Worker", "In a process of its own: a crash or lack of memory there does not take Blender down"),
        update=_on_edit,
    )
    worker_python: text(
        "Worker's Python",
        "Python executable with torch, numba and onnxruntime for the worker; empty for the installed runtime",
        subtype="FILE_PATH",
        update=_on_edit,
    )
    device: choice(
        "Device",
        "What the model computes on",
        ("auto", "Automatic", "CUDA where it works, else the processor"),
        ("cpu", "Processor", "All machines"),
        ("cuda", "CUDA", "NVIDIA graphics card"),
        ("mps", "Metal", "Apple graphics"),
        update=_on_edit,
    )
    threads: whole("Threads", "Processor threads for the model; 0 uses all", min=0, max=1024, update=_on_edit)
    weights: text(
        "Weights",
        "Trained weights for the default avatar and random people; empty for those that come with the extension",
        subtype="FILE_PATH",
        update=_on_edit,
    )
    flame: text(
        "FLAME File",
        "Your own FLAME model (generic_model.pkl or flame2023.pkl), for Add > GRMM; none is distributed",
        subtype="FILE_PATH",
    )
    install_python: text("Base Python", "Python that the runtime is built upon; empty for Blender's own", subtype="FILE_PATH")
    wheels: text("Wheels", "Folder of wheels to install from without network; empty to fetch packages", subtype="DIR_PATH")
    index: text(
        "Package Index", "Address of a package index, for example one with smaller builds without CUDA; empty for the usual one"
    )
    favourites: text("Favourites", "Names of the controls that have a star", options={"HIDDEN"})
    show_install_options: flag("Options", "Show where the runtime is installed from")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preferences."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        status = session_host.runtime_status()
        draw_text(layout, status.message, context, icon="CHECKMARK" if status.available else "ERROR")
        column = layout.column()
        column.prop(self, "runtime")
        row = column.row()
        row.active = self.runtime != "local"
        row.prop(self, "worker_python")
        column.prop(self, "device")
        column.prop(self, "threads")
        column.prop(self, "weights")
        column.prop(self, "flame")
        self._draw_installation(layout.box(), context)
        layout.operator(GRMM_OT_copy_diagnostics.bl_idname, icon="COPYDOWN")

    def _draw_installation(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        facts = runtime_install.installed_facts(_folder())
        machine = runtime_install.detect_machine()
        layout.label(text=f"This machine: {machine.system}, {machine.accelerator or 'no accelerator found'}")
        if _job is not None and _job.running:
            draw_progress(layout, _job.progress, INSTALL)
            layout.operator(GRMM_OT_cancel_runtime.bl_idname, icon="CANCEL")
            return
        if facts:
            versions = ", ".join(f"{name} {facts[name]}" for name in ("python", "torch", "numba") if name in facts)
            layout.label(text=f"Installed runtime: {versions}")
        else:
            layout.label(text="No PyTorch installed: photos, videos, voices and graphics cards need it")
            draw_text(layout, machine.advice, context)
            if not bpy.app.online_access and not self.wheels:
                draw_text(layout, OFFLINE, context, icon="INFO")
        if _job is not None and _job.error:
            draw_text(layout, _job.error, context, icon="ERROR")
        row = layout.row()
        row.operator(
            GRMM_OT_install_runtime.bl_idname,
            text="Try Again" if _job is not None and _job.error else "Reinstall Runtime" if facts else "Install Runtime",
            icon="IMPORT",
        )
        if facts:
            row.operator(GRMM_OT_remove_runtime.bl_idname, icon="TRASH")
        icon = "DISCLOSURE_TRI_DOWN" if self.show_install_options else "DISCLOSURE_TRI_RIGHT"
        layout.prop(self, "show_install_options", icon=icon, emboss=False)
        if self.show_install_options:
            layout.prop(self, "install_python")
            layout.prop(self, "wheels")
            layout.prop(self, "index")


class GRMM_OT_install_runtime(Operator):
    """Install torch and what else the model needs into a folder of the extension's own; Blender stays usable."""

    bl_label = "Install Runtime"
    bl_options: ClassVar[set[str]] = {"REGISTER", "INTERNAL"}

    wait: flag("Wait", "Return when it is done, for scripts", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One installation at a time, and with the user's permission to go online only."""
        if _job is not None and _job.running:
            cls.poll_message_set("An installation is running")
            return False
        if not bpy.app.online_access and not get().wheels:
            cls.poll_message_set("Allow Online Access in Preferences > System, or choose a folder of wheels")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the installation."""
        global _job
        preferences = get()
        wheels = bpy.path.abspath(preferences.wheels) if preferences.wheels else ""
        if wheels and not Path(wheels).is_dir():
            self.report({"ERROR"}, f"{wheels} is not a folder; choose the folder of wheels again.")
            return {"CANCELLED"}
        # Nothing may use the runtime while it is replaced.
        session_host.shutdown()
        python = bpy.path.abspath(preferences.install_python) if preferences.install_python else sys.executable
        _job = runtime_install.InstallJob(runtime_install.InstallRequest(_folder(), python, wheels, preferences.index))
        _job.start()
        if not self.wait:
            bpy.app.timers.register(_poll, first_interval=_POLL_SECONDS, persistent=True)
            return {"FINISHED"}
        _job.wait()
        _finish()
        if _job.error:
            self.report({"ERROR"}, _job.error)
            return {"CANCELLED"}
        return {"FINISHED"}


class GRMM_OT_cancel_runtime(Operator):
    """Stop the installation and remove what it fetched so far."""

    bl_label = "Cancel"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while one runs."""
        return _job is not None and _job.running

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Stop it."""
        if _job is not None:
            _job.cancel()
        return {"FINISHED"}


class GRMM_OT_remove_runtime(Operator):
    """Delete the installed runtime; avatars keep their rigs and can be rendered after another installation."""

    bl_label = "Remove"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not while one is being installed."""
        return _job is None or not _job.running

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first."""
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Delete it."""
        session_host.shutdown()
        try:
            runtime_install.remove(_folder())
        except GrmmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        _apply(get())
        return {"FINISHED"}


class GRMM_OT_copy_diagnostics(Operator):
    """Copy a text about versions, devices and the runtime to the clipboard, for a bug report."""

    bl_label = "Copy Diagnostics"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy it."""
        text = diagnostics.report()
        if _job is not None and _job.log:
            text += "\n\nInstallation's last lines:\n" + _job.log
        context.window_manager.clipboard = text
        self.report({"INFO"}, "The diagnostics are in the clipboard")
        return {"FINISHED"}


CLASSES = (
    GRMM_OT_install_runtime,
    GRMM_OT_cancel_runtime,
    GRMM_OT_remove_runtime,
    GRMM_OT_copy_diagnostics,
    GRMM_AddonPreferences,
)


def get() -> GRMM_AddonPreferences | SimpleNamespace:
    """Return the preferences: their defaults where the extension was enabled for this process only (`blender --addons`)."""
    found = bpy.context.preferences.addons.get(compat.ROOT_PACKAGE)
    if found is not None:
        return found.preferences
    declared = GRMM_AddonPreferences.bl_rna.properties
    return SimpleNamespace(**{name: declared[name].default for name in GRMM_AddonPreferences.__annotations__})


def are_kept() -> bool:
    """Whether there are preferences to write into."""
    return compat.ROOT_PACKAGE in bpy.context.preferences.addons


def register() -> None:
    """Use the saved values."""
    _apply(get())


def unregister() -> None:
    """Stop an installation; there is nobody left to watch it."""
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
    if _job is not None and _job.running:
        _job.cancel()
        _job.wait()


def _folder() -> Path:
    return Path(compat.user_folder(""))


def _poll() -> float | None:
    """Timer while an installation runs: show its progress, then use the result."""
    windows.redraw("PREFERENCES")
    if _job is not None and _job.running:
        return _POLL_SECONDS
    _finish()
    return None


def _finish() -> None:
    if _job is not None and not _job.error:
        _apply(get(), renewed=True)
