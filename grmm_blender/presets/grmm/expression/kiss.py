"""Puckered lips."""

import bpy

head = next(o for o in (bpy.context.object, *bpy.context.object.children) if "jawOpen" in o)

head["mouthPucker"] = 0.95
head["mouthFunnel"] = 0.15
head["cheekSquintLeft"] = 0.1
head["cheekSquintRight"] = 0.1
