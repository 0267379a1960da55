"""Draw every panel of the extension on a recording layout: each property and operator named in it must exist."""

from __future__ import annotations

import bpy
from panel_recorder import Narrow, draw_all
from support import empty_scene, module, report

empty_scene()
report(without=draw_all())
bpy.ops.grmm.add_head()
report(head=draw_all())
report(narrow=draw_all(Narrow()))
module("grmm_blender.rig.avatar").avatar_of(bpy.context.object).object.grmm.source = "/nowhere/gone.grmm"
missing = draw_all()
report(missing={"text": " ".join(missing["labels"]), "operators": missing["operators"]})
report(registered=[p.bl_rna.identifier for p in module("grmm_blender.panels").CLASSES if p.is_registered])
