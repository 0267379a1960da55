"""The order of all steps, and walking through them."""

from __future__ import annotations

from pathlib import Path

from . import animator, closer, corners, filming, steps
from .blender import WalkedBlender, WalkError

STEPS: tuple[steps.Step, ...] = (
    steps.start, steps.install, corners.menus, steps.add_head, steps.first_render, steps.panels, closer.tooltips,
    animator.drag_rig, closer.head_alone, animator.choose_runtime, closer.many_views, steps.look, closer.close_up,
    closer.look_undone, closer.search, steps.sliders, steps.random_and_reset, steps.poses, corners.questions, steps.views,
    corners.graded, animator.bare_mesh, animator.import_options, steps.performance, closer.played_frames, steps.escape,
    steps.photos, steps.undo, closer.copies, animator.recordings, corners.channels, corners.import_avatar, animator.turntable,
    animator.motion, animator.written, steps.save_and_reopen, corners.without_window, steps.eevee, steps.drop, steps.delete,
    corners.disabled_while_playing, animator.fit, filming.video, filming.voice, steps.disable_and_enable,
)  # fmt: skip


def check_console(text: str) -> list[str]:
    """Return the lines of Blender's console that a user should never see."""
    return [line for line in text.splitlines() if "Traceback" in line or line.startswith(("Error:", "Warning: class"))]


def walk(blender: WalkedBlender, extension: Path) -> list[str]:
    """Take every step; return what went wrong, by step."""
    problems = []
    blender.bring(extension, "grmm.zip")
    for step in STEPS:
        before, waited = len(blender.console), len(blender.waits)
        try:
            step(blender)
        except WalkError as error:
            problems.append(f"{step.__name__}: {error}")
        for wait in blender.waits[waited:]:
            places = "; ".join(place for place, _ in wait["places"])
            blender.note(f"{step.__name__}: {wait['seconds']} s, {wait['processor_seconds']} s of them computing, in {places}")
        problems += [f"{step.__name__}: {line}" for line in check_console(blender.console[before:])]
    return problems
