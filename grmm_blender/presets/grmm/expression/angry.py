"""Lowered brows, pressed lips."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["browDownLeft"] = 0.95
head["browDownRight"] = 0.95
head["noseSneerLeft"] = 0.4
head["noseSneerRight"] = 0.4
head["mouthPressLeft"] = 0.6
head["mouthPressRight"] = 0.6
head["eyeSquintLeft"] = 0.4
head["eyeSquintRight"] = 0.4
head["jawForward"] = 0.2
