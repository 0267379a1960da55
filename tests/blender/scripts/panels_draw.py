"""Draw every panel of the extension on a recording layout: each property and operator named in it must exist."""

from __future__ import annotations

import bpy
from panel_recorder import Narrow, draw_all, panels
from render_support import unpainted
from support import empty_scene, module, report

empty_scene()
report(without=draw_all())
with unpainted():
    bpy.ops.grmm.add_head()
report(head=draw_all())
report(narrow=draw_all(Narrow()))
manager = bpy.context.window_manager
tooltips = []
for name, values in (
    ("reset", {"region": "Lips"}), ("mirror", {"direction": "LEFT", "region": "Brows"}),
    ("mirror", {"direction": "SWAP", "region": "ALL"}), ("drag_face", {"handle": "upper_lid_left"}),
):  # fmt: skip
    properties = manager.operator_properties_last(f"grmm.{name}")
    for key, value in values.items():
        setattr(properties, key, value)
    tooltips.append(getattr(bpy.types, f"GRMM_OT_{name}").description(bpy.context, properties))
report(tooltips=tooltips)
shown = manager.grmm_panels
for name in ("lip up", "mouthUpperUp", "brow left", "neck", "no such thing"):
    shown.search = name
    found = draw_all()
    report(**{f"search {name}": {"panels": found["panels"], "properties": found["properties"], "text": found["labels"]}})
shown.search = ""
shown.show_stars = True
for name in ("mouthSmileRight", "neck", "jawOpen", "jawOpen"):
    bpy.ops.grmm.favourite(control=name)
starred = draw_all()
report(starred={"panels": starred["panels"], "stars": starred["operators"].count("grmm.favourite")})
report(favourites=module("grmm_blender.panels.favourites").names(), smiles=starred["properties"].count('["mouthSmileLeft"]'))
module("grmm_blender.rig.avatar").avatar_of(bpy.context.object).object.grmm.source = "/nowhere/gone.grmm"
missing = draw_all()
report(missing={"text": " ".join(missing["labels"]), "operators": missing["operators"]})
report(registered=[p.bl_rna.identifier for p in panels() if p.is_registered])
