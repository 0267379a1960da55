"""Walk everything that the extension registers, and list what a user would miss: ui_audit.py."""

from __future__ import annotations

import inspect

import bpy
from panel_recorder import panels
from render_support import unpainted
from support import MODULE, empty_scene, module, report

NUMBERS = ("INT", "FLOAT")
FAR = 1e30  # Blender's own limits are larger: none was set
FILE_SELECTOR = ("filepath", "directory", "files", "filename", "filter_glob", "check_existing")  # filled in by its browser
INTERNAL = "INTERNAL"


def ours(base: type) -> list[type]:
    """Registered classes of the extension below a Blender type."""
    found, waiting = [], [base]
    while waiting:
        cls = waiting.pop()
        waiting += cls.__subclasses__()
        if MODULE in cls.__module__ and getattr(cls, "is_registered", False):
            found.append(cls)
    return sorted(set(found), key=lambda cls: cls.__name__)


def property_problems(owner: str, cls: type, rna: bpy.types.Struct | None = None) -> list[str]:
    """What is missing on the properties that a class declares; an operator's are those of its own `rna`."""
    problems = []
    for prop in (rna or cls.bl_rna).properties:
        declared = any(prop.identifier in getattr(base, "__annotations__", {}) for base in cls.__mro__)
        if not declared or prop.identifier in FILE_SELECTOR or prop.is_hidden:
            continue
        where = f"{owner}.{prop.identifier}"
        if not prop.name:
            problems.append(f"{where} has no name")
        if not prop.description and prop.type != "COLLECTION":
            problems.append(f"{where} has no description")
        if prop.description.endswith("."):
            problems.append(f"{where}: description ends with a point")
        far = FAR if prop.type == "FLOAT" else 2**31 - 2
        if prop.type in NUMBERS and not prop.is_readonly and min(abs(prop.hard_min), abs(prop.hard_max)) > far:
            problems.append(f"{where} has no range")
        if prop.type == "ENUM":
            problems += [f"{where}.{item.identifier} has no description" for item in prop.enum_items if not item.description]
    return problems


def operator_problems(cls: type) -> list[str]:
    rna = getattr(bpy.ops.grmm, cls.bl_idname.partition(".")[2]).get_rna_type()
    problems = property_problems(cls.__name__, cls, rna)
    if not cls.__name__.startswith("GRMM_OT_"):
        problems.append(f"{cls.__name__} is not named GRMM_OT_*")
    if not rna.description or rna.description == rna.name:
        problems.append(f"{cls.__name__} has no description")
    if not getattr(cls, "bl_label", ""):
        problems.append(f"{cls.__name__} has no label, so search does not find it")
    if not hasattr(cls, "poll") and INTERNAL not in getattr(cls, "bl_options", set()) and "context.scene" in _source(cls):
        problems.append(f"{cls.__name__} has no poll")
    if "poll" in vars(cls) and "return False" in inspect.getsource(cls.poll) and "poll_message_set" not in inspect.getsource(
        cls.poll
    ) and INTERNAL not in getattr(cls, "bl_options", set()):  # fmt: skip
        problems.append(f"{cls.__name__} is greyed out without a reason")
    return problems


def _source(cls: type) -> str:
    return inspect.getsource(cls.execute) if hasattr(cls, "execute") else ""


empty_scene()
operators = ours(bpy.types.Operator)
undoing = sorted(cls.__name__ for cls in operators if "UNDO" in getattr(cls, "bl_options", set()))
problems = [problem for cls in operators for problem in operator_problems(cls)]
groups = [*ours(bpy.types.PropertyGroup), *ours(bpy.types.AddonPreferences)]
problems += [problem for cls in groups for problem in property_problems(cls.__name__, cls)]
registered = ours(bpy.types.Panel)
problems += [f"{cls.__name__} has no label" for cls in registered if not cls.bl_label and "HIDE_HEADER" not in cls.bl_options]
problems += [f"{cls.__name__} is not named GRMM_PT_*" for cls in registered if not cls.__name__.startswith("GRMM_PT_")]

with unpainted():
    bpy.ops.grmm.add_head()
head = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object).object
for name in head.keys():  # noqa: SIM118
    if name.startswith("grmm"):
        continue
    ui = head.id_properties_ui(name).as_dict()
    if not ui.get("description"):
        problems.append(f"property {name} of the head has no description")
    if not abs(ui.get("max", FAR)) < FAR or not abs(ui.get("min", FAR)) < FAR:
        problems.append(f"property {name} of the head has no range")


class Opening:
    """Stands in for the context while a file is being opened: there is no active object to ask for."""

    def __getattr__(self, name: str) -> object:
        if name in ("object", "active_object"):
            raise AttributeError(name)
        return getattr(bpy.context, name)


shelves = ours(bpy.types.AssetShelf)
asked = [
    cls.__name__
    for cls in (*operators, *shelves, *ours(bpy.types.FileHandler))
    if hasattr(cls, "poll") and [cls.poll(Opening())]
]

# panels follow the selection: head and armature show the same, another object shows none of an avatar's
contents = [cls for cls in panels() if cls.bl_space_type == "VIEW_3D"]


def shown() -> list[str]:
    return [cls.__name__ for cls in contents if not hasattr(cls, "poll") or cls.poll(bpy.context)]


def select(obj: bpy.types.Object) -> list[str]:
    bpy.context.view_layer.objects.active = obj
    return shown()


empty = bpy.data.objects.new("Empty", None)
bpy.context.scene.collection.objects.link(empty)
report(
    problems=problems,
    asked=asked,
    operators=[cls.__name__ for cls in operators],
    undoing=undoing,
    properties=sum(len(cls.bl_rna.properties) for cls in groups),
    panels={"head": select(head), "armature": select(head.parent), "empty": select(empty)},
)
