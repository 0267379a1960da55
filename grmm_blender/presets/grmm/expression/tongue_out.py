"""Open mouth and tongue."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["tongueOut"] = 1.0
head["jawOpen"] = 0.35
head["mouthSmileLeft"] = 0.2
head["mouthSmileRight"] = 0.2
