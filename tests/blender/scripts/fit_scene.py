"""What becomes of a finished fit: in the scene, undone, beside another head, in another file; asking before a file is replaced.

Arguments: folder to write to. The job is a stand-in; the avatar is one of the library's, with a photo's camera.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
from support import empty_scene, enable, module, report


def avatar_file(folder: Path) -> Path:
    """An avatar as a fit writes it: with the camera of its photo."""
    avatar_module, camera = module("grmm_core.avatar"), module("grmm_core.geometry.camera").Camera
    source = module("grmm_core.avatar.library").library_file("library:long")
    avatar = dataclasses.replace(avatar_module.load_avatar(source), name="Ada", camera=camera.orbit(256, 256))
    avatar_module.save_avatar(avatar, folder / "ada.grmm")
    return folder / "ada.grmm"


class FinishedJob:
    """Stands in for a process that has written an avatar."""

    def __init__(self, path: Path, running: bool = False) -> None:
        self.status = module("grmm_blender.fitting.job").FitStatus(state="done", avatar=str(path))
        self.running = running

    def cancel(self) -> None: ...

    def wait(self, _timeout: float) -> None: ...


def shown() -> dict[str, object]:
    heads = [item for item in bpy.data.objects if item.type == "MESH" and item.parent is not None]
    return {
        "heads": sorted(round(item.parent.location.x, 3) for item in heads),
        "cameras": sorted(item.parent.name for item in bpy.data.objects if item.type == "CAMERA"),
    }


def follow(path: Path, running: bool = False) -> None:
    request = module("grmm_core.fitting.request").FitRequest((path.with_suffix(".jpg"),), path)
    module("grmm_blender.fitting.watch").start(FinishedJob(path, running), request)


def undone_and_beside(path: Path) -> None:
    watch = module("grmm_blender.fitting.watch")
    empty_scene()
    bpy.ops.ed.undo_push(message="before")
    follow(path)
    report(waits=watch.waits_to_be_added(), note=watch.finish(bpy.context), one=shown(), waits_then=watch.waits_to_be_added())
    report(frames=[item.data.display_size for item in bpy.data.objects if item.type == "CAMERA"])
    follow(path)
    report(beside=watch.finish(bpy.context), two=shown())
    bpy.ops.ed.undo()
    report(undone=shown())
    bpy.ops.ed.undo()
    report(undone_twice=shown())
    bpy.ops.ed.redo()
    report(redone=shown())


def in_edit_mode(path: Path) -> None:
    watch = module("grmm_blender.fitting.watch")
    empty_scene()
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.mode_set(mode="EDIT")
    follow(path)
    try:
        watch.finish(bpy.context)
    except module("grmm_core.errors").GrmmError as error:
        report(edit_mode=str(error), still_waits=watch.waits_to_be_added(), can_add=bpy.ops.grmm.fit_add_to_scene.poll())
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.grmm.fit_add_to_scene()
    report(added_later=shown()["cameras"])


def in_another_file(path: Path) -> None:
    watch = module("grmm_blender.fitting.watch")
    empty_scene()
    follow(path)
    watch.finish(bpy.context)
    empty_scene()
    try:
        watch.job()
    except module("grmm_core.errors").GrmmError as error:
        report(note_of_before=watch.note(), no_job=str(error))
    follow(path, running=True)
    empty_scene()
    watch.job().running = False
    report(begun_elsewhere=watch.finish(bpy.context), not_added=shown(), offered=watch.waits_to_be_added())
    bpy.ops.grmm.fit_add_to_scene()
    report(added_here=shown()["cameras"])


def sidebar_alone_is_drawn_again(path: Path) -> None:
    watch, windows = module("grmm_blender.fitting.watch"), module("grmm_blender.windows")
    areas = windows.areas
    drawn: list[str] = []
    regions = [SimpleNamespace(type=kind, tag_redraw=lambda kind=kind: drawn.append(kind)) for kind in ("WINDOW", "UI")]
    follow(path, running=True)
    windows.areas = lambda *kinds: iter([SimpleNamespace(regions=regions)])
    again = watch._poll()
    windows.areas = areas
    watch.job().running = False
    report(while_it_runs=drawn, looks_again=again is not None)


def asked_before_replacing(path: Path) -> None:
    """The operator's `invoke`, as a window calls it, with a window manager that notes the question."""
    operators, asked = module("operators.fit"), []
    choices = bpy.context.window_manager.grmm_fit
    choices.photos.clear()
    choices.photos.add().path = str(path.with_suffix(".jpg"))
    manager = SimpleNamespace(
        grmm_fit=choices, invoke_confirm=lambda _operator, _event, **words: asked.append(words["message"]) or {"RUNNING_MODAL"}
    )
    context = SimpleNamespace(window_manager=manager)

    def press(resume: bool = False) -> list[str]:
        operator = SimpleNamespace(resume=resume, execute=lambda _context: {"FINISHED"})
        return sorted(operators.GRMM_OT_fit_photos.invoke(operator, context, None))

    choices.output = str(path)
    report(there=press(), resumed=press(resume=True), asked=asked)
    choices.output = str(path.with_name("new.grmm"))
    report(new=press(), asked_then=len(asked))


folder = Path(sys.argv[-1])
enable()
file = avatar_file(folder)
undone_and_beside(file)
in_edit_mode(file)
in_another_file(file)
sidebar_alone_is_drawn_again(file)
asked_before_replacing(file)
