"""The learned laugh, with raised brows."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["laugh"] = 1.0
head["browInnerUp"] = 0.2
