"""The left eye closes, the mouth smiles to that side."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["eyeBlinkLeft"] = 1.0
head["cheekSquintLeft"] = 0.6
head["mouthSmileLeft"] = 0.6
head["mouthSmileRight"] = 0.3
head["browOuterUpRight"] = 0.2
