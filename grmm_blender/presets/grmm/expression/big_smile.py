"""A broad smile with open lips."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["mouthSmileLeft"] = 1.0
head["mouthSmileRight"] = 1.0
head["cheekSquintLeft"] = 0.6
head["cheekSquintRight"] = 0.6
head["eyeSquintLeft"] = 0.4
head["eyeSquintRight"] = 0.4
head["mouthUpperUpLeft"] = 0.3
head["mouthUpperUpRight"] = 0.3
head["jawOpen"] = 0.12
