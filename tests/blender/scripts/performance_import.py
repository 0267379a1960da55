"""Import performances onto a head: performance_import.py FOLDER (with the files of test_blender_performance)."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from rig_support import core_mesh, fresh_head, largest, mesh_of, without_detail
from support import module, report

folder = Path(sys.argv[1])
actions = module("grmm_blender.rig.actions")
read_performance = module("grmm_core.formats").read_performance
ARKIT = module("grmm_core.controls.names").ARKIT_NAMES
scene = bpy.context.scene


def new_head():
    global scene
    avatar = without_detail(fresh_head())
    scene = bpy.context.scene
    scene.render.fps = 30
    return avatar


def curves_of(obj) -> dict:
    return {(curve.data_path, curve.array_index): curve for curve in actions.action_curves(obj)}


def speech() -> dict:
    avatar = new_head()
    bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), start=5)
    recorded = read_performance(folder / "speech.json")
    found, meshes = [], []
    for k in range(0, recorded.frame_count, 37):
        scene.frame_set(5 + k)
        found.append(largest(avatar.controls().aligned[:52] - recorded.weights[k].clip(0, 1)))
        meshes.append(largest(mesh_of(avatar) - core_mesh(avatar)))
    curves = curves_of(avatar.object)
    return {
        "error": max(found),
        "parity": max(meshes),
        "range": [scene.frame_start, scene.frame_end],
        "groups": sorted({curve.group.name for curve in curves.values()}),
        "curves": len(curves),
        "action": avatar.object.animation_data.action.name,
    }


def rate_and_gain() -> dict:
    """The same recording in a 24 fps scene, stronger, twice on one curve."""
    avatar = new_head()
    scene.render.fps = 24
    bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), start=1, gain=0.5)
    recorded = read_performance(folder / "speech.json")
    jaw = ARKIT.index("jawOpen")
    scene.frame_set(1 + 48)  # two seconds
    half = float(avatar.controls().aligned[jaw] / recorded.weights[60, jaw])
    last = scene.frame_end
    bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), start=1001, set_range=False, present="WRITE_INTO")
    scene.frame_set(1 + 48)
    kept = float(avatar.controls().aligned[jaw] / recorded.weights[60, jaw])
    scene.frame_set(1001 + 48)
    full = float(avatar.controls().aligned[jaw] / recorded.weights[60, jaw])
    return {"half": half, "last": last, "kept": kept, "full": full, "end": scene.frame_end}


def takes() -> dict:
    """What becomes of an animation that the avatar has: its own keys, a first recording, a second one."""
    avatar = new_head()
    head, rig = avatar.object, avatar.armature
    head["browInnerUp"] = 0.7
    head.keyframe_insert('["browInnerUp"]', frame=3)
    rig.pose.bones["neck"].keyframe_insert("rotation_euler", frame=3)
    own = head.animation_data.action
    bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"))
    kept = [curve.data_path for curve in actions.action_curves(rig)]
    first = head.animation_data.action
    result = {"named": first.name, "own": [own.use_fake_user, len(own.layers[0].strips[0].channelbags[0].fcurves)], "rig": kept}
    bpy.ops.grmm.import_performance(filepath=str(folder / "live_link.csv"), start=21, present="PUSH_DOWN")
    tracks = [[(s.action.name, s.frame_start) for s in track.strips] for track in head.animation_data.nla_tracks]
    scene.frame_set(31)
    recorded = read_performance(folder / "live_link.csv")
    smile = float(avatar.controls().aligned[ARKIT.index("mouthSmileLeft")])
    return result | {
        "tracks": tracks,
        "second": head.animation_data.action.name,
        "rig_tracks": [strip.action.name for track in rig.animation_data.nla_tracks for strip in track.strips],
        "shared": rig.animation_data.action == head.animation_data.action,
        "smile": smile - float(recorded.weights[20, ARKIT.index("mouthSmileLeft")].clip(0, 1)),
    }


def reduced() -> dict:
    avatar = new_head()
    bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), keys="REDUCED", max_error=0.02)
    recorded = read_performance(folder / "speech.json").weights.clip(0, 1)
    keys = sum(len(curve.keyframe_points) for curve in curves_of(avatar.object).values())
    errors = []
    for k in range(0, len(recorded), 7):
        scene.frame_set(1 + k)
        errors.append(largest(avatar.controls().aligned[:52] - recorded[k]))
    return {"keys": keys, "all": recorded.size, "error": max(errors)}


def live_link() -> dict:
    avatar = new_head()
    bpy.ops.grmm.import_performance(filepath=str(folder / "live_link.csv"), keys="SAMPLES")
    recorded = read_performance(folder / "live_link.csv")
    scene.frame_set(11)  # a third of a second: sample 20 of 60 a second
    controls = avatar.controls()
    result = {
        "neck": largest(controls.pose[1] - recorded.head_rotation[20]),
        "eyes": largest(controls.pose[3:]),
        "smile": float(controls.aligned[ARKIT.index("mouthSmileLeft")]),
        "slots": sorted(slot.name_display for slot in avatar.object.animation_data.action.slots),
        "shared": avatar.armature.animation_data.action == avatar.object.animation_data.action,
        "samples": len(next(iter(curves_of(avatar.object).values())).keyframe_points),
    }
    avatar = new_head()
    bpy.ops.grmm.import_performance(filepath=str(folder / "live_link.csv"), eyes="ROTATIONS", head="NONE")
    scene.frame_set(11)
    controls = avatar.controls()
    result |= {
        "eye_bones": largest(controls.pose[3] - recorded.left_eye_rotation[20]),
        "eye_shapes": largest(controls.aligned[[i for i, n in enumerate(ARKIT) if n.startswith("eyeLook")]]),
        "no_neck": largest(controls.pose[1]),
    }
    return result


def cleaned() -> dict:
    """Neutral frames, gain per region, offset, a part of the recording: what the core makes of the same options."""
    avatar = new_head()
    core = module("grmm_core.performance")
    recorded = read_performance(folder / "speech.json")
    bpy.ops.grmm.import_performance(
        filepath=str(folder / "speech.json"), start=1, neutral="FRAMES", neutral_frames="3, 10-12", gain=0.9, gain_jaw=0.5,
        gain_mouth=0.8, smoothing=0.3, offset=0.5, first=1.0, last=4.0, close_lips=False,
    )  # fmt: skip
    wanted = core.clean(
        recorded,
        core.CleanOptions(start=1.0, end=4.0, neutral=(3, 10, 11, 12), gains={"all": 0.9, "jaw": 0.5, "mouth": 0.8},
                          smoothing=0.3, fps=30),
    )  # fmt: skip
    errors = []
    for k in (0, 20, 90):
        scene.frame_set(1 + 15 + k)
        errors.append(largest(avatar.controls().aligned[:52] - wanted.weights[k]))
    return {"error": max(errors), "range": [scene.frame_start, scene.frame_end]}


def flame_on_ours() -> dict:
    """FLAME's coefficients on the open head, by way of the user's FLAME file."""
    avatar = new_head()
    core = module("grmm_core.performance")
    head = module("grmm_core.head").load_flame(folder / "flame2023.pkl")
    bpy.ops.grmm.import_performance(
        filepath=str(folder / "talk.npz"), flame_file=str(folder / "flame2023.pkl"), fps=30, eyes="ROTATIONS"
    )
    wanted = core.to_arkit(read_performance(folder / "talk.npz", fps=30), head)
    scene.frame_set(1 + 5)
    return {
        "error": largest(avatar.controls().aligned[:52] - wanted.weights[5]),
        "moved": largest(wanted.weights),
        "neck": largest(avatar.controls().pose[1] - wanted.neck_rotation[5] - wanted.head_rotation[5]),
    }


def messages() -> dict:
    """What the operator says to files it cannot use, and what is left of them."""
    avatar = new_head()
    result = {}
    for name in ("gone.json", "empty.json", "unknown.csv", "truncated.json", "flame.npz", ""):
        try:
            bpy.ops.grmm.import_performance(filepath=str(folder / name) if name else "")
            result[name] = "accepted"
        except RuntimeError as error:
            result[name] = str(error).strip().splitlines()[0].removeprefix("Error: ")
    try:
        bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), start=1e7)
    except RuntimeError as error:
        result["far"] = str(error).strip().splitlines()[0].removeprefix("Error: ")
    for text in ("", "x", "5-2", "9999"):
        try:
            bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), neutral="FRAMES", neutral_frames=text)
        except RuntimeError as error:
            result[f"neutral {text}"] = str(error).strip().splitlines()[0].removeprefix("Error: ")
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = None
    return {
        "messages": result,
        "untouched": avatar.object.animation_data is None or not curves_of(avatar.object),
        "poll": bpy.ops.grmm.import_performance.poll(),
    }


def edits() -> dict:
    """Mirror, reset, random: on a posed head."""
    avatar = new_head()
    head, bones = avatar.object, avatar.armature.pose.bones
    head["mouthSmileLeft"], head["jawLeft"] = 0.8, 0.3
    head["expression"][52] = 0.4  # unitEyeLeftClosure
    bones["left_eye"].rotation_euler, bones["neck"].rotation_euler = (0.1, 0.2, 0.0), (0.1, 0.3, -0.1)
    bpy.ops.grmm.mirror(direction="LEFT")
    copied = [head["mouthSmileRight"], head["jawRight"], head["jawLeft"], *bones["right_eye"].rotation_euler]
    copied += [head["expression"][52], head["expression"][55], bones["neck"].rotation_euler[1]]
    head["mouthSmileRight"] = 0.1
    bpy.ops.grmm.mirror()
    swapped = [head["mouthSmileLeft"], head["mouthSmileRight"], head["jawRight"], *bones["neck"].rotation_euler]
    bpy.ops.grmm.reset(what="EXPRESSION", region="Mouth")
    reset = [head["mouthSmileLeft"], head["jawRight"]]
    scene.tool_settings.use_keyframe_insert_auto = True
    scene.frame_set(9)
    bpy.ops.grmm.reset()
    rest = [largest(avatar.controls().pose), largest(avatar.controls().aligned), float(head["residual_strength"])]
    keyed = len(curves_of(head)) > 60 and all(c.keyframe_points[0].co[0] == 9 for c in curves_of(head).values())
    scene.tool_settings.use_keyframe_insert_auto = False
    drawn = []
    for seed in (3, 3, 4):
        bpy.ops.grmm.random_expression(seed=seed)
        drawn.append(avatar.controls().aligned.copy())
    bpy.ops.grmm.random_identity(seed=5)
    return {
        "copied": [float(v) for v in copied],
        "swapped": [float(v) for v in swapped],
        "reset": [float(v) for v in reset],
        "rest": rest,
        "keyed": keyed,
        "same": largest(drawn[0] - drawn[1]),
        "other": largest(drawn[0] - drawn[2]),
        "largest": largest(drawn[2]),
        "shape": largest(avatar.controls().shape),
        "parity": largest(mesh_of(avatar) - core_mesh(avatar)),
    }


report(speech=speech(), rate=rate_and_gain(), takes=takes())
report(reduced=reduced())
report(live_link=live_link())
report(cleaned=cleaned(), flame=flame_on_ours())
report(messages=messages())
report(edits=edits())


def drawn_options() -> dict:
    """Every option of the import operator stands in one panel of the file browser, and exists."""
    operator = module("operators.import_performance").GRMM_OT_import_performance
    properties = bpy.ops.grmm.import_performance.get_rna_type().properties
    names: list[str] = []

    class Layout:
        use_property_split = False

        def panel(self, name: str, default_closed: bool = False) -> tuple:
            return self, self

        def column(self) -> object:
            return self

        def label(self, text: str) -> None:
            assert text

        def prop(self, owner: object, name: str) -> None:
            assert name in properties, name
            names.append(name)

    functions = {name: value for name, value in vars(operator).items() if callable(value)}
    values = {"layout": Layout(), "keys": "REDUCED", "neutral": "FRAMES"}
    stand_in = type("Drawn", (), {**functions, **values})()
    stand_in.draw(bpy.context)
    hidden = {"rna_type", "filepath", "filter_glob"}
    return {"missing": sorted(set(properties.keys()) - set(names) - hidden), "twice": len(names) - len(set(names))}


report(drawn_options=drawn_options())
