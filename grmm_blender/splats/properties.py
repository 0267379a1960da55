"""`Object.grmm_cloud`: what makes a mesh object a splat cloud, and what it was read from."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from .. import session_host
from ..declare import flag, text
from . import cloud


def _is_mesh(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "MESH" and obj != self.id_data


class GRMM_PG_cloud(bpy.types.PropertyGroup):
    """Settings of a splat cloud."""

    is_cloud: flag("Splat Cloud", "The points of this mesh are Gaussians that the GRMM engine draws", options={"HIDDEN"})
    source: text(
        "Source",
        "File that the splats were read from; the splats themselves are part of the .blend file",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    )
    kind: text("Kind", "What the file holds", options={"HIDDEN"})
    carrier: bpy.props.PointerProperty(
        name="Carrier",
        description="Mesh whose triangles move the splats; none for splats that move by themselves",
        type=bpy.types.Object,
        poll=_is_mesh,
    )
    carries: flag("Carries Splats", "This mesh moves splats and is not drawn itself by the GRMM engine", options={"HIDDEN"})


@persistent
def _on_load(*_: object) -> None:
    cloud.forget()
    session_host.release_clouds()


CLASSES = (GRMM_PG_cloud,)


def register() -> None:
    """Attach the group to objects."""
    bpy.types.Object.grmm_cloud = bpy.props.PointerProperty(type=GRMM_PG_cloud, name="GRMM Splat Cloud")
    bpy.app.handlers.load_post.append(_on_load)


def unregister() -> None:
    """Take the group back; the values stay in the files."""
    if _on_load in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.remove(_on_load)
    del bpy.types.Object.grmm_cloud
