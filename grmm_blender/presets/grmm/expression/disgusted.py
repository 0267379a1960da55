"""The learned disgust."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["disgust"] = 1.0
