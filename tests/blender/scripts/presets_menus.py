"""Presets, menus and operators of the extension: presets_menus.py."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import bpy
from rig_support import fresh_head
from support import module, report

avatar = fresh_head()
head = avatar.object
names = module("grmm_core.controls.names").ALIGNED_NAMES
presets = module("grmm_blender.preset_menus")
shown = lambda: {n: round(head[n], 4) for n in names if abs(head[n]) > 1e-6}  # noqa: E731


def files(subdir: str) -> list[Path]:
    return [Path(f) / n for f in bpy.utils.preset_paths(subdir) for n in sorted(p.name for p in Path(f).glob("*.py"))]


def load(path: Path, menu: str) -> None:
    bpy.ops.script.execute_preset(filepath=str(path), menu_idname=menu)


results = {}
for path in files(presets.EXPRESSION_FOLDER):
    head["jawRight"] = 0.9
    load(path, "GRMM_MT_expression_presets")
    results[path.stem] = shown()
# With the armature active the head is still found.
bpy.context.view_layer.objects.active = avatar.armature
load(files(presets.EXPRESSION_FOLDER)[0], "GRMM_MT_expression_presets")
report(expressions=results, from_armature=shown())

# Whatever sets values from Python has the editors drawn again, which custom properties do not by themselves.
drawn_again: list[str] = []
module("grmm_blender.rig.avatar").redraw = lambda *kinds: drawn_again.extend(kinds)
editors = {}
for name, options in (
    ("random_expression", {"seed": 2}), ("mirror", {}), ("random_identity", {"seed": 2}), ("random_detail", {"seed": 2}),
    ("save_pose", {"name": "Mine"}), ("apply_pose", {"pose": "Mine"}), ("reset", {}),
):  # fmt: skip
    drawn_again.clear()
    getattr(bpy.ops.grmm, name)(**options)
    editors[name] = list(drawn_again)
drawn_again.clear()
load(files(presets.EXPRESSION_FOLDER)[0], "GRMM_MT_expression_presets")
report(drawn_again=editors | {"preset": list(drawn_again)})

render = {}
settings = bpy.context.scene.grmm_render
for path in files(presets.RENDER_FOLDER):
    load(path, "GRMM_MT_render_presets")
    render[path.stem] = [settings.use_refine, settings.detail, settings.motion_steps]
report(render=render)

bpy.ops.grmm.reset()
head["mouthPucker"] = 0.4
bpy.ops.grmm.expression_preset_add(name="my kiss")
bpy.ops.grmm.render_preset_add(name="mine")
head["mouthPucker"] = 0.0
own = [path for path in files(presets.EXPRESSION_FOLDER) if path.stem == "my_kiss"]
load(own[0], "GRMM_MT_expression_presets")
report(own=shown(), user_file="presets/grmm/expression" in own[0].as_posix() and "extensions" not in own[0].parts)
bpy.ops.grmm.expression_preset_add(remove_active=True)
report(removed=not own[0].exists())
bpy.ops.grmm.render_preset_add(remove_name=True, name="mine")

# Every operator: described, with a class, in a menu that the search looks into.
described, drawn, labels = {}, [], []


class Recorder:
    operator_context = ""

    def operator(self, name: str, text: str = "", **_: object) -> SimpleNamespace:
        drawn.append(name)
        labels.append(text)
        return SimpleNamespace()

    def menu(self, name: str, **_: object) -> None:
        drawn.append(name)
        menu = getattr(bpy.types, name)
        if name.startswith("GRMM_MT") and not hasattr(menu, "preset_subdir"):
            menu.draw(type("Drawn", (), {"layout": self})(), bpy.context)

    def separator(self) -> None: ...


Recorder().menu("GRMM_MT_main")
internal = [
    name for name in dir(bpy.ops.grmm) if "INTERNAL" in getattr(getattr(bpy.types, f"GRMM_OT_{name}"), "bl_options", ())
]
for name in dir(bpy.ops.grmm):
    kind = getattr(bpy.ops.grmm, name).get_rna_type()
    described[name] = [kind.name, kind.description, [p.identifier for p in kind.properties if not p.is_hidden
                       and p.identifier != "rna_type" and not (p.name and p.description)]]  # fmt: skip
report(described=described, drawn=drawn, labels=labels, internal=internal)
shown_in = [bpy.types.VIEW3D_MT_object, bpy.types.VIEW3D_MT_pose]
report(places=[any(f.__module__.endswith("menus") for f in menu.draw._draw_funcs) for menu in shown_in])
