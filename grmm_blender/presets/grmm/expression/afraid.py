"""Wide eyes, stretched mouth."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["browInnerUp"] = 1.0
head["browOuterUpLeft"] = 0.4
head["browOuterUpRight"] = 0.4
head["eyeWideLeft"] = 0.9
head["eyeWideRight"] = 0.9
head["mouthStretchLeft"] = 0.6
head["mouthStretchRight"] = 0.6
head["jawOpen"] = 0.2
