"""Fast pictures: fewer Gaussians, no refinement."""

import bpy

settings = bpy.context.scene.grmm_render

settings.use_refine = False
settings.detail = "1"
settings.use_occlusion = True
settings.occlusion_samples = 1
settings.motion_steps = 3
settings.use_viewport_refine = False
settings.viewport_detail = "2"
