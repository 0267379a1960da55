"""Stand-ins for what Blender 3.4 lacks, so that the extension's panels and drawing code run in its window.

Left out there: drag and drop (FileHandler), the asset shelf, action slots (so no import of performances and no pose library),
bone collections and bone colors (bones have layers and keep their default color), the extension system itself. The head's
mesh is made face by face, because polygons there need their length as well as their start. Splats in the viewport need
`depth_write` of shaders, which came later; the mesh is shown.
"""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path
from typing import Any

import bpy

PACKAGE = "bl_ext.user_default.grmm"
ROOT = Path(__file__).resolve().parents[2]


class _Collections:
    """Stands in for `Armature.collections`."""

    def new(self, name: str) -> types.SimpleNamespace:
        return types.SimpleNamespace(name=name, is_visible=True, assign=lambda bone: None)


class _More:
    """An object of Blender's with further attributes."""

    def __init__(self, base: object, **more: object) -> None:
        self.__dict__.update(more)
        self._base = base

    def __getattr__(self, name: str) -> object:
        return getattr(self._base, name)


def install(user_folder: Path) -> types.ModuleType:
    """Put the stand-ins in place where something is missing, and import the extension from the checkout.

    Args:
        user_folder: Takes what the extension writes.
    """
    for name in ("FileHandler", "AssetShelf"):
        if not hasattr(bpy.types, name):
            setattr(bpy.types, name, type(name, (), {}))
    if not hasattr(bpy.types.ID, "session_uid"):
        bpy.types.ID.session_uid = property(lambda self: self.as_pointer() >> 4 & 0x7FFFFFFF)
    if not hasattr(bpy.types.Armature, "collections"):
        bpy.types.Armature.collections = property(lambda self: _Collections())
    if not hasattr(bpy.types.Bone, "color"):
        bpy.types.Bone.color = property(lambda self: types.SimpleNamespace(palette=""))
    if not hasattr(bpy.types.ID, "is_editable"):
        bpy.types.ID.is_editable = property(lambda self: self.library is None)
    if not hasattr(bpy.types.ShapeKey, "points"):
        bpy.types.ShapeKey.points = property(lambda self: self.data)
    if not hasattr(bpy.utils, "extension_path_user"):
        bpy.utils.extension_path_user = lambda package, path="", create=False: _folder(user_folder / path, create)
    for name in ("register_preset_path", "unregister_preset_path"):
        if not hasattr(bpy.utils, name):
            setattr(bpy.utils, name, lambda path: True)
    if not hasattr(bpy.app.handlers, "animation_playback_post"):
        later: dict[str, list[Any]] = {"animation_playback_pre": [], "animation_playback_post": []}  # lists that nobody calls
        bpy.app = _More(bpy.app, handlers=_More(bpy.app.handlers, **later), online_access=False)
    if PACKAGE not in bpy.context.preferences.addons:
        bpy.context.preferences.addons.new().module = PACKAGE
    _tolerate_missing_classes()
    for parent in ("bl_ext", "bl_ext.user_default"):
        sys.modules[parent] = types.ModuleType(parent)
        sys.modules[parent].__path__ = []
    spec: Any = importlib.util.spec_from_file_location(PACKAGE, ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules[PACKAGE] = package
    spec.loader.exec_module(package)
    if not bpy.types.MeshPolygon.bl_rna.properties["loop_total"].is_readonly:
        _replace_make_mesh(importlib.import_module(f"{PACKAGE}.grmm_blender.rig.mesh"))
    return package


def _replace_make_mesh(module: Any) -> None:
    """Build the head's mesh as older Blenders want it."""

    def make_mesh(name: str, identity: Any) -> bpy.types.Mesh:
        head = identity.head
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(module.to_blender(identity.vertices).tolist(), [], head.faces.tolist())
        mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
        layer = mesh.uv_layers.new(name=module.UV_NAME)
        layer.data.foreach_set("uv", head.uv[head.uv_faces.ravel()].ravel().tolist())
        module._add_materials(mesh, head)
        mesh.update()
        return mesh

    module.make_mesh = make_mesh


def _folder(path: Path, create: bool) -> str:
    if create:
        path.mkdir(parents=True, exist_ok=True)
    return str(path)


def _tolerate_missing_classes() -> None:
    """Let classes of kinds that this Blender does not know pass by."""
    register, unregister = bpy.utils.register_class, bpy.utils.unregister_class

    def register_known(cls: type) -> None:
        if issubclass(cls, bpy.types.bpy_struct):
            register(cls)

    def unregister_known(cls: type) -> None:
        if issubclass(cls, bpy.types.bpy_struct):
            unregister(cls)

    bpy.utils.register_class, bpy.utils.unregister_class = register_known, unregister_known
