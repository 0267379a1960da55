"""Draw the extension's panels on a layout that resolves and notes what they draw."""

from __future__ import annotations

from types import FunctionType, SimpleNamespace

import bpy
from support import module


class Recorder:
    """Stands in for UILayout: resolves what a panel draws and notes it."""

    def __init__(self, notes: dict[str, list[str]]) -> None:
        self.notes, self.active = notes, True

    def prop(self, data: object, path: str, **options: object) -> None:
        value = data.path_resolve(path)
        if "index" in options:
            value[options["index"]]
        if path.startswith('["') and "index" not in options:
            self.notes["names"].append(options["text"] or self.notes["labels"][-1])
        if not self.active:
            self.notes["dimmed"].append(path)
        self.notes["properties"].append(path if "index" not in options else f"{path}[{options['index']}]")

    def operator(self, name: str, **_: object) -> object:
        kind, function = name.split(".")
        self.notes["operators"].append(name)
        properties = getattr(getattr(bpy.ops, kind), function).get_rna_type().properties

        class Settable:
            def __setattr__(self, attribute: str, value: object) -> None:
                assert attribute in properties, f"{name} has no {attribute}"

        return Settable()

    def label(self, text: str = "", **_: object) -> None:
        self.notes["labels"].append(text)

    def row(self, **_: object) -> Recorder:
        return Recorder(self.notes)

    column = box = split = grid_flow = row

    def menu(self, name: str, **_: object) -> None:
        assert hasattr(bpy.types, name), name

    def menu_contents(self, name: str) -> None:
        drawn(getattr(bpy.types, name), self).draw(bpy.context)

    def template_icon_view(self, data: object, path: str, **_: object) -> None:
        assert getattr(data, path)
        self.notes["properties"].append(path)

    def separator(self) -> None:
        pass


class Narrow:
    """Stands in for the context of a sidebar as it is first opened; in background there is no region."""

    region = SimpleNamespace(width=220)

    def __getattr__(self, name: str) -> object:
        return getattr(bpy.context, name)


def panels() -> list[type]:
    """The panels of the sidebar and of the data tab."""
    return [cls for cls in module("grmm_blender.panels").CLASSES if issubclass(cls, bpy.types.Panel)]


def drawn(cls: type, layout: Recorder) -> object:
    """A stand-in for what Blender alone can make instances of, with the functions of the class and of its plain content."""
    functions = {name: value for name, value in vars(cls).items() if isinstance(value, FunctionType)}
    content = [base for base in cls.__mro__[1:2] if not issubclass(base, bpy.types.bpy_struct)]
    instance = type("Drawn", tuple(content), functions)()
    instance.layout, instance.bl_label = layout, cls.bl_label
    return instance


def draw_all(context: object = bpy.context) -> dict[str, list[str]]:
    notes: dict[str, list[str]] = {"properties": [], "operators": [], "labels": [], "panels": [], "names": [], "dimmed": []}
    for panel in panels():
        if panel.poll(context):
            notes["panels"].append(panel.__name__)
            instance = drawn(panel, Recorder(notes))
            if hasattr(instance, "draw_header_preset"):
                instance.draw_header_preset(context)
            instance.draw(context)
    return notes
