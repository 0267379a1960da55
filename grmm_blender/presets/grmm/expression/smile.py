"""A friendly smile."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["mouthSmileLeft"] = 0.7
head["mouthSmileRight"] = 0.7
head["cheekSquintLeft"] = 0.35
head["cheekSquintRight"] = 0.35
head["eyeSquintLeft"] = 0.2
head["eyeSquintRight"] = 0.2
head["mouthDimpleLeft"] = 0.15
head["mouthDimpleRight"] = 0.15
