"""Inner brows up, corners of the mouth down."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["browInnerUp"] = 0.8
head["mouthFrownLeft"] = 0.7
head["mouthFrownRight"] = 0.7
head["mouthShrugLower"] = 0.4
head["eyeLookDownLeft"] = 0.25
head["eyeLookDownRight"] = 0.25
