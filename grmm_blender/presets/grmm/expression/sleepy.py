"""Half closed eyes."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["eyeBlinkLeft"] = 0.6
head["eyeBlinkRight"] = 0.6
head["browInnerUp"] = 0.2
head["jawOpen"] = 0.06
head["browOuterUpLeft"] = 0.15
head["browOuterUpRight"] = 0.15
