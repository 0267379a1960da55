"""Smooth edges and blur for delivery."""

import bpy

settings = bpy.context.scene.grmm_render

settings.use_refine = True
settings.detail = "0"
settings.use_occlusion = True
settings.occlusion_samples = 5
settings.motion_steps = 16
settings.use_viewport_refine = True
settings.viewport_detail = "0"
