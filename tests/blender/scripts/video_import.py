"""Performances from recordings inside Blender: video_import.py FOLDER, with speech.mp4 (with sound), text.mp4 and voice.ogg.

The first capture and the voice are whole; those between are stand-ins for processes that have ended in other ways.
"""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
from render_support import unpainted
from rig_support import fresh_head, without_detail
from support import empty_scene, module, report

folder = Path(sys.argv[1])
actions = module("grmm_blender.rig.actions")
watch = module("grmm_blender.recordings.watch")
SAYS = "import json, sys; print(json.dumps({event})); sys.exit({code})"


def curves_of(obj) -> dict:
    return {(curve.data_path, curve.array_index): curve for curve in actions.action_curves(obj)}


def handles(strip) -> list[int]:
    """Where a strip is heard from and up to, and where its file begins."""
    new = hasattr(strip, "left_handle")
    names = ("left_handle", "right_handle", "content_start") if new else ("frame_final_start", "frame_final_end", "frame_start")
    return [round(getattr(strip, name)) for name in names]


def said_by(operator) -> str:
    try:
        operator()
    except (RuntimeError, module("grmm_core.errors").GrmmError) as error:
        return str(error)
    return ""


def imported() -> dict:
    poll_without = bpy.ops.grmm.import_video.poll()
    avatar = without_detail(fresh_head())
    scene = bpy.context.scene
    scene.render.fps = 15
    bpy.ops.grmm.import_video(
        filepath=str(folder / "speech.mp4"), start=11, first=0.2, keys="FRAMES", smoothing=0.0, neutral="NONE"
    )
    head, rig = curves_of(avatar.object), curves_of(avatar.armature)
    jaw = next(curve for (path, _), curve in head.items() if "jawOpen" in path)
    turn = rig['pose.bones["neck"].rotation_euler', 1]
    strips = scene.sequence_editor.strips
    return {
        "poll_without": poll_without,
        "jaw": [jaw.evaluate(11 + frame) for frame in range(12)],
        "turn": [turn.evaluate(11 + frame) for frame in range(12)],
        "range": [scene.frame_start, scene.frame_end],
        "action": avatar.object.animation_data.action.name,
        "note": watch.note(),
        "sound": [[strip.name, *handles(strip)[::2]] for strip in strips],
    }


def job_that_says(event: dict, code: int = 0):
    """A job that follows a process which writes one event."""
    job = job_of(SAYS.format(event=event, code=code))
    job.wait(60)
    return job


def job_of(source: str):
    """A job that follows a process which runs this."""
    process = subprocess.Popen(
        [sys.executable, "-c", source], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    return module("grmm_blender.recordings.job").TrackJob(process)


def follow(job, avatar) -> None:
    request = module("grmm_core.video.request").TrackRequest(folder / "speech.mp4", folder / "take.json")
    options = module("grmm_blender.performance").ImportOptions()
    watch.start(job, request, avatar.object, options, set_range=True, sound=False, message="Import Video")


def ended(event: dict, code: int = 0, before=None) -> dict:
    """What is said of a capture that ended with an event; `before` happens while it runs."""
    avatar = fresh_head()
    follow(job_that_says(event, code), avatar)
    said = {}
    if before is not None:
        said["before"] = before(avatar)
    said["message"] = said_by(lambda: watch.finish(bpy.context))
    said["note"] = watch.note()
    return said


def cancelled() -> dict:
    """Of the head that is there."""
    avatar = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)
    job = job_of("import time; time.sleep(60)")
    follow(job, avatar)
    polls = [bpy.ops.grmm.import_video.poll(), bpy.ops.grmm.cancel_recording.poll()]
    bpy.ops.grmm.cancel_recording()
    job.wait(30)
    message = said_by(lambda: watch.finish(bpy.context))
    return {"polls": polls, "message": message, "keyed": len(curves_of(avatar.object))}


def another_scene() -> dict:
    """The window shows another scene when the capture ends; then one step of undo, and the file is left."""
    head = fresh_head().object.name
    scene = bpy.context.scene.name
    bpy.ops.ed.undo_push(message="before")
    follow(job_that_says(done), module("grmm_blender.rig.avatar").avatar_of(bpy.data.objects[head]))
    bpy.context.window.scene = bpy.data.scenes.new("Other")

    def state() -> list:
        found = bpy.data.objects[head]
        keyed = found.animation_data is not None and found.animation_data.action is not None
        return [keyed, len(bpy.data.actions), bpy.data.scenes[scene].frame_end]

    said = {"note": watch.finish(bpy.context), "keyed": state(), "other": bpy.context.scene.frame_end}
    bpy.ops.ed.undo()
    said["undone"] = state()
    bpy.ops.ed.redo()
    said["redone"] = state()
    open_another(None)
    said["note_of_before"] = watch.note()
    return said


def own_shape() -> list[list]:
    """Whether the option is shown, and whose shape is asked for: of the head that is there, and of one from a photo."""
    avatars, operators = module("grmm_core.avatar"), module("operators.import_video")
    made = avatars.load_avatar(module("grmm_core.avatar.library").library_file("library:bald"))
    made = dataclasses.replace(made, provenance=avatars.Provenance(from_photos=True))
    avatars.save_avatar(made, folder / "ada.grmm")
    asked = []

    def start(_python: str, request):
        asked.append(request.person and request.person.name)
        raise module("grmm_core.errors").ConfigError("This is far enough.")

    def seen() -> list:
        drawn = []
        layout = SimpleNamespace(prop=lambda _operator, name: drawn.append(name))
        operators.GRMM_OT_import_video.draw(SimpleNamespace(layout=layout), bpy.context)
        said_by(lambda: bpy.ops.grmm.import_video(filepath=str(folder / "speech.mp4"), own_shape=True))
        return [len(drawn), "own_shape" in drawn, asked[-1]]

    whole, operators.TrackJob = operators.TrackJob, SimpleNamespace(start=start)
    found = [seen()]
    with unpainted():
        bpy.ops.grmm.add_head(filepath=str(folder / "ada.grmm"))
    found.append(seen())
    operators.TrackJob = whole
    return found


def remove(avatar) -> str:
    for obj in (avatar.object, avatar.armature):
        bpy.data.objects.remove(obj)
    return "removed"


def open_another(_avatar) -> str:
    empty_scene()
    return "opened"


def spoken() -> dict:
    """A voice, in a scene that has sound already."""
    avatar = without_detail(fresh_head())
    scene = bpy.context.scene
    scene.render.fps = 30
    scene.sequence_editor_create().strips.new_sound("music", str(folder / "voice.ogg"), 1, 1)
    bpy.ops.grmm.import_voice(filepath=str(folder / "voice.ogg"), start=10)
    curves = curves_of(avatar.object)
    count = scene.frame_end - scene.frame_start + 1

    def curve(name: str) -> list[float]:
        found = next(curve for (path, _), curve in curves.items() if name in path)
        return [found.evaluate(10 + frame) for frame in range(count)]

    drawn = []
    operators, layout = module("operators.import_voice"), SimpleNamespace(prop=lambda _operator, name: drawn.append(name))
    for language in ("ENGLISH", "OTHER"):
        drawn.append(language)
        operators.GRMM_OT_import_voice.draw(SimpleNamespace(layout=layout, language=language), bpy.context)
    return {
        "note": watch.note(),
        "jaw": curve("jawOpen"),
        "close": curve("mouthClose"),
        "turned": any("rotation_euler" in path for path, _ in curves_of(avatar.armature)),
        "keys": max(len(curve.keyframe_points) for curve in curves.values()),
        "range": [scene.frame_start, scene.frame_end],
        "strips": sorted([strip.name, strip.channel, handles(strip)[0]] for strip in scene.sequence_editor.strips),
        "text": [drawn.count("said"), drawn.index("said") < drawn.index("OTHER")],
        "silent": said_by(lambda: bpy.ops.grmm.import_voice(filepath=str(folder / "silence.wav"))),
        "none": said_by(lambda: bpy.ops.grmm.import_voice()),
    }


def spoken_over_keys() -> dict:
    """Voices on a head that smiles: one that replaces the smile, the same again, another one, and one that is added to it."""
    avatar = without_detail(fresh_head())
    head, scene = avatar.object, bpy.context.scene
    sync = scene.sync_mode
    for frame, value in ((1, 0.2), (40, 0.4)):
        head["mouthSmileLeft"] = value
        head.keyframe_insert('["mouthSmileLeft"]', frame=frame)
    own = head.animation_data.action
    shutil.copy(folder / "voice.ogg", folder / "other.ogg")

    def heard() -> list:
        return sorted([strip.name, strip.mute] for strip in scene.sequence_editor.strips)

    def speak(name: str, **options) -> dict:
        bpy.ops.grmm.import_voice(filepath=str(folder / name), language="OTHER", liveliness=0.0, **options)
        return {"strips": heard(), "action": head.animation_data.action.name, "note": watch.note()}

    def smile(frame: int) -> float:
        scene.frame_set(frame)
        return avatar.controls().aligned[names.index("mouthSmileLeft")].item()

    names = list(module("grmm_core.controls.names").ARKIT_NAMES)
    said = {"first": speak("voice.ogg"), "sync": [sync, scene.sync_mode], "own": [own.name, own.use_fake_user]}
    shown = {getattr(workspace, "sequencer_scene", scene) for workspace in bpy.data.workspaces}
    said["seen"] = shown <= {scene}
    said["again"] = speak("voice.ogg", strength=0.5)
    said["other"] = speak("other.ogg")
    spoken = [smile(frame) for frame in (1, 20, 40)]
    speak("voice.ogg", start=7, first=0.5, last=2.0)
    strips = scene.sequence_editor.strips
    said["part"] = [*handles(strips[head.animation_data.action["grmm_sound"]]), scene.frame_end]
    said["heard"] = sum(not mute for _, mute in heard())
    speak("voice.ogg", start=101, present="WRITE_INTO")
    said["next"] = [sum(not mute for _, mute in heard()), scene.frame_start, scene.frame_end]
    speak("other.ogg", start=101, present="WRITE_INTO")
    speak("other.ogg", start=101, present="WRITE_INTO", strength=0.5)
    said["second_take"] = [strip.name for strip in strips if not strip.mute]
    speak("voice.ogg", start=201)
    said["alone"] = [strip.name for strip in strips if not strip.mute]
    said["count"] = len(strips)
    head.animation_data.action = own
    said["added"] = speak("voice.ogg", start=1, present="ADD")
    said["smile"] = [smile(frame) - value for frame, value in zip((1, 20, 40), spoken, strict=True)]
    said["tracks"] = [strip.action.name for track in head.animation_data.nla_tracks for strip in track.strips]
    return said


def errors() -> dict:
    avatar = fresh_head()
    missing = said_by(lambda: bpy.ops.grmm.import_video(filepath=str(folder / "none.mp4")))
    text = said_by(lambda: bpy.ops.grmm.import_video(filepath=str(folder / "text.mp4")))
    backwards = said_by(lambda: bpy.ops.grmm.import_video(filepath=str(folder / "speech.mp4"), first=3.0, last=1.0))
    return {"missing": missing, "text": text, "backwards": backwards, "keyed": len(curves_of(avatar.object))}


done = {"event": "done", "performance": str(Path(bpy.app.tempdir) / "grmm_recordings" / "speech.json")}  # of the first capture
report(
    imported=imported(),
    spoken=spoken(),
    over_keys=spoken_over_keys(),
    errors=errors(),
    cancelled=cancelled(),
    own_shape=own_shape(),
    gone=ended(done, before=remove),
    another=ended(done, before=open_another),
    another_scene=another_scene(),
    nameless=ended({"event": "done"}),
    failed=ended({"event": "error", "message": "No face was found in speech.mp4."}, 1),
)
