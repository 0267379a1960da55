"""Eyes up and to the side, pressed lips."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["eyeLookUpLeft"] = 0.5
head["eyeLookUpRight"] = 0.5
head["eyeLookOutLeft"] = 0.4
head["eyeLookInRight"] = 0.4
head["mouthPressLeft"] = 0.4
head["mouthPressRight"] = 0.4
head["browInnerUp"] = 0.2
head["mouthShrugUpper"] = 0.2
