"""The splat viewport's thread and arithmetic, on a Blender without graphics: viewport_plain.py WEIGHTS"""

from __future__ import annotations

import itertools
import sys
from types import SimpleNamespace

import bpy
import numpy as np
from render_support import new_scene
from support import module, report

arrays = module("grmm_blender.viewport.arrays")
camera_class = module("grmm_core.geometry.camera").Camera
controls_class = module("grmm_core.controls.frame").Controls
errors = module("grmm_core.errors")
jobs_module = module("grmm_blender.viewport.jobs")
pace_class = module("grmm_blender.pace").Pace
shot_class = module("grmm_blender.scene.shot").AvatarShot
sources = module("grmm_blender.viewport.sources")

# A scene with a head works on without a graphics card, whatever Blender reports of changes.
scene = new_scene(sys.argv[1], size=(16, 16))
scene.frame_set(2)
scene.grmm_viewport.detail = "1"
bpy.ops.render.render()
bones = module("grmm_blender.viewport.bones")
rig = bpy.context.object if bpy.context.object.type == "ARMATURE" else bpy.context.object.parent
bpy.context.view_layer.objects.active = rig
looked_at = len(list(bones.posed_bones(bpy.context, bpy.context.evaluated_depsgraph_get())))
bpy.ops.object.mode_set(mode="POSE")
report(bones=[looked_at, len(list(bones.posed_bones(bpy.context, bpy.context.evaluated_depsgraph_get())))])
report(callbacks=len(module("grmm_blender.events")._drawing), rendered=True)

# The level of detail follows measured times; the first one is that of loading.
pace = pace_class()
begun = [pace.is_begun(0)]
pace.record(0, 100.0)
begun.append(pace.is_begun(0))
levels = [pace.level(0, 0.04)]
report(first_measure=levels[0], begun=begun)
for level, seconds in ((0, 0.2), (1, 0.1), (2, 0.09), (3, 0.08)):
    pace.record(level, seconds)
    if level < 2:
        levels.append(pace.level(0, 0.04))
levels.append(pace.level(0, 0.04))
pace.forget()
levels.append(pace.level(0, 0.04))
report(levels=levels)
pace.record(0, 0.06)  # a slow moment: the finest level is tried again after some pictures of the next
doubted = [pace.level(0, 0.04)]
for _ in range(60):
    pace.doubt(1)
doubted.append(pace.level(0, 0.04))
report(doubted=doubted)
# In playback drawing counts too; where Blender alone is slower than the rate, splats may take a fourth of its time.
# What was made while Blender drew says little about what a frame that waits for it takes.
ways = []
for others in (0.01, 1.0):
    pace = pace_class()
    for _ in range(2):
        pace.record(0, 100.0)
    for _ in range(6):
        way = pace.way(0, 0.04)
        ways.append(way)
        if way is not None:
            pace.record_frame(way, (0.9, 0.5, 0.3, 0.26, 0.24)[way], others)
pace.forget()
report(ways=ways, again=pace.way(0, 0.04))

# The thread, with a clock that goes one second a look, and Gaussians from a stand-in.
log: list[list[object]] = []
plan = SimpleNamespace(error=None)


def world_gaussians(shot, camera, lod):
    log.append([shot.name, lod, float(np.linalg.norm(sources.view_direction(shot, camera)))])
    if plan.error is not None:
        raise plan.error
    ones = np.ones(3, np.float32)
    return arrays.WorldGaussians(np.eye(3), np.ones((3, 6), np.float32), np.ones((3, 3), np.float32), ones, ones)


sources.world_gaussians = world_gaussians
ticks = itertools.count()
jobs = jobs_module.SplatJobs(clock=lambda: float(next(ticks)), wait_for_rest=lambda is_outdated: None)


def served(scene_shots, yaw: float, playing: bool = False, distance: float = 1.0) -> list[list[object]]:
    log.clear()
    camera = camera_class.orbit(64, 64, yaw=yaw, distance=distance)
    jobs.request(jobs_module.SplatRequest(scene_shots, camera, level=2, finest=0, playing=playing))
    if not jobs.wait(60):
        raise RuntimeError("stuck")
    return [list(entry) for entry in log]


alike = "a", "default", controls_class(), np.eye(4)
shots = sources.ViewportShot((shot_class(*alike),))
other = sources.ViewportShot((shot_class("a", "default", controls_class(), 2.0 * np.eye(4)),))
report(played=served(other, 0.0, playing=True))
report(made=served(shots, 0.0))
bob = shot_class(*alike, hair=module("grmm_core.session").HairUse("groom:bob"))
report(other_hair=[jobs_module.same_shot(shots.shots[0], one) for one in (shot_class(*alike), bob)])
report(camera_moved=served(shots, 0.2))
# Turned so far that colors are stale: they come in the moving level first, then in full.
report(turned=served(shots, 40.0))
# So near that pixels are finer than those of training pictures: Gaussians are widened once the view rests.
report(neared=[served(shots, 40.0, distance=distance) for distance in (0.5, 0.02, 0.0201)])
served(shots, 40.0)
plan.error = errors.SessionError("The model worker ended.")
served(sources.ViewportShot(tuple([*shots.shots])), 0.0)
served(sources.ViewportShot((shot_class("a", "default", controls_class(), np.eye(4) * 1.0),)), 80.0)
report(error=list(jobs.take().messages))
plan.error = ZeroDivisionError("oops")
served(sources.ViewportShot((shot_class("a", "default", controls_class(), np.eye(4) * 1.0),)), 120.0)
report(defect=list(jobs.take().messages))

# More than fits is thinned out; what is not finite is left out.
arrays.MAX_GAUSSIANS = 100
many = 1001
none = np.zeros(many, np.float32)
large = arrays.WorldGaussians(np.zeros((many, 3)), np.zeros((many, 6), np.float32), np.zeros((many, 3), np.float32), none, none)
means = np.array([[0.0, 0, 0], [np.nan, 0, 0], [1, 0, 0]], np.float32)
placed = arrays.WorldGaussians.place(means, np.eye(4, dtype=np.float32)[[0, 0, 0]], np.ones((3, 3), np.float32),
                                     np.ones(3, np.float32), np.ones((3, 3), np.float32), np.eye(4))  # fmt: skip
report(thinned=len(arrays.pack(large)), finite=len(placed))
