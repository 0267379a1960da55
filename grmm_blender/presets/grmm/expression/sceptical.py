"""One brow up, the mouth to one side."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["browOuterUpLeft"] = 0.8
head["browDownRight"] = 0.6
head["mouthLeft"] = 0.35
head["mouthPressRight"] = 0.4
head["mouthFrownLeft"] = 0.2
