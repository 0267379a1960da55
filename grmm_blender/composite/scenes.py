"""The partner scene of a composite: made, kept in step, removed.

Called by the composite operators, and on every edit: the partner follows the main scene's objects, visibility, camera,
size and times, so that nothing has to be set twice.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ...grmm_core.errors import GrmmError
from .. import events
from ..engine.settings import ENGINE
from ..properties import STUDIO_LIGHT
from ..scene import walk
from ..scene.avatars import avatars_in, is_drawn
from ..scene.clouds import clouds_in
from . import hair_shadows, nodes

# Settings of the picture that both scenes must share, in an order in which Blender accepts them.
_RENDER = (
    "resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y",
    "fps", "fps_base", "frame_map_old", "frame_map_new",
    "use_border", "use_crop_to_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y",
    "use_motion_blur", "motion_blur_position", "motion_blur_shutter", "use_multiview", "views_format",
)  # fmt: skip
_SCENE = ("frame_start", "frame_end", "frame_step", "camera", "world")
_LAYER_FLAGS = ("exclude", "holdout", "indirect_only")
_DELAY = 0.1  # seconds


def partner_of(scene: bpy.types.Scene) -> bpy.types.Scene | None:
    """Return the scene that renders this scene's avatars, or None where no composite is set up."""
    partner = scene.grmm_composite.partner
    return partner if partner is not None and partner.grmm_composite.main == scene else None


def drawn_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the objects of a scene that other engines must not draw: in their place stand Gaussians."""
    carriers = [cloud.carrier for cloud in clouds_in(scene) if cloud.carrier is not None]
    return [*walk.drawn_objects(scene), *dict.fromkeys(carriers), *hair_shadows.curves_of(scene)]


def studio_lit(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the heads drawn in a scene that can be changed and have the studio's even light, whatever shines on the rest."""
    heads = (avatar.object for avatar in avatars_in(scene) if is_drawn(avatar))
    return [head for head in heads if head.is_editable and head.grmm.lighting == STUDIO_LIGHT]


def set_up(scene: bpy.types.Scene) -> bpy.types.Scene:
    """Set a composite up, or put an existing one right again; returns the partner.

    Args:
        scene: Main scene, of any engine but GRMM.

    Raises:
        GrmmError: The scene has no avatar, is itself a partner, is rendered by GRMM alone, or has a linked head.
    """
    if scene.grmm_composite.main is not None:
        raise GrmmError(f"This scene renders the avatars of {scene.grmm_composite.main.name}; go to that scene first.")
    if scene.render.engine == ENGINE:
        raise GrmmError("The GRMM engine renders this scene already; choose Cycles or EEVEE to composite with.")
    found = drawn_objects(scene)
    if not found:
        raise GrmmError("The scene has no GRMM avatar; add one with Add > GRMM.")
    linked = [obj.name for obj in found if not obj.is_editable]
    if linked:
        raise GrmmError(f"{linked[0]} is linked; make a library override of it first.")
    partner = partner_of(scene)
    if partner is None:
        partner = bpy.data.scenes.new(f"{scene.name} Avatars")
        partner.render.engine = ENGINE
        partner.render.film_transparent = True
        partner.render.use_compositing = partner.render.use_sequencer = False
        partner.view_layers[0].name = "Avatars"
        partner.view_layers[0].use_pass_z = True
        scene.grmm_composite.partner, partner.grmm_composite.main = partner, scene
    for view_layer in scene.view_layers:
        view_layer.use_pass_z = True
    scene.render.use_compositing = True
    hair_shadows.make(scene)
    sync(scene)
    nodes.insert(scene, partner)
    return partner


def remove(scene: bpy.types.Scene) -> None:
    """Take a composite away again: nodes, partner scene, hidden heads. The scene's own nodes are as they were."""
    partner = scene.grmm_composite.partner
    nodes.remove(scene)
    scene.grmm_composite.partner = None
    for obj in drawn_objects(scene):
        # A head in several composites stays with the others.
        if obj.grmm_handed_over and not any(partner_of(s) and s != scene for s in obj.users_scene):
            obj.grmm_handed_over, obj.visible_camera = False, True
    hair_shadows.remove(scene)
    if partner is not None:
        bpy.data.scenes.remove(partner)


def sync(scene: bpy.types.Scene) -> bool:
    """Bring the partner in step with its main scene; returns whether anything had to be changed."""
    partner = partner_of(scene)
    if partner is None:
        return False
    changed = sync_settings(scene)
    changed |= _sync_members(scene.collection, partner.collection)
    changed |= _sync_layers(_layer_root(scene), _layer_root(partner))
    for obj in drawn_objects(scene):
        if not obj.grmm_handed_over and obj.visible_camera and obj.is_editable:
            obj.grmm_handed_over, obj.visible_camera = True, False
            changed = True
    return changed


def sync_settings(scene: bpy.types.Scene) -> bool:
    """Copy the settings of picture and time to the partner; returns whether any was different."""
    partner = partner_of(scene)
    if partner is None:
        return False
    changed = [_copy(scene.render, partner.render, name) for name in _RENDER]
    changed += [_copy(scene, partner, name) for name in _SCENE]
    return any([*changed, _sync_markers(scene, partner)])


def _copy(source: object, target: object, name: str) -> bool:
    value = getattr(source, name)
    if getattr(target, name) == value:
        return False
    setattr(target, name, value)
    return True


def _sync_markers(scene: bpy.types.Scene, partner: bpy.types.Scene) -> bool:
    """Copy the markers that switch cameras."""
    wanted = [(marker.name, marker.frame, marker.camera) for marker in scene.timeline_markers if marker.camera]
    if [(marker.name, marker.frame, marker.camera) for marker in partner.timeline_markers] == wanted:
        return False
    partner.timeline_markers.clear()
    for name, frame, camera in wanted:
        partner.timeline_markers.new(name, frame=frame).camera = camera
    return True


def _sync_members(source: bpy.types.Collection, target: bpy.types.Collection) -> bool:
    """Let a scene's own collection hold the same objects and sub-collections; the latter are shared with all they hold."""
    changed = False
    for kind in ("objects", "children"):
        wanted, present = set(getattr(source, kind)), set(getattr(target, kind))
        for item in wanted - present:
            getattr(target, kind).link(item)
        for item in present - wanted:
            getattr(target, kind).unlink(item)
        changed |= wanted != present
    return changed


def _layer_root(scene: bpy.types.Scene) -> bpy.types.LayerCollection:
    """Return the root of the first view layer, which Blender 5 fills in only when its objects are asked for."""
    view_layer = scene.view_layers[0]
    _ = view_layer.objects.active
    return view_layer.layer_collection


def _sync_layers(source: bpy.types.LayerCollection, target: bpy.types.LayerCollection) -> bool:
    """Let a view layer exclude what the main one excludes."""
    changed = False
    for child in source.children:
        twin = target.children.get(child.name)
        if twin is not None:
            changed |= any([_copy(child, twin, name) for name in _LAYER_FLAGS])
            changed |= _sync_layers(child, twin)
    return changed


@persistent
def _on_edit(scene: bpy.types.Scene, _depsgraph: bpy.types.Depsgraph) -> None:
    # Not at once: Blender 5.2 crashes when another scene's members change while this one's update is being reported.
    if scene.grmm_composite.partner is not None:
        events.later(_sync_later, _DELAY)


def _sync_later() -> None:
    for scene in bpy.data.scenes:
        sync(scene)


@persistent
def _before_render(scene: bpy.types.Scene, *_: object) -> None:
    """Settings that were changed without an edit's event, as scripts do; objects cannot be linked on a render's thread."""
    if scene.grmm_composite.partner is None:
        return
    if bpy.app.background:
        sync(scene)
    else:
        sync_settings(scene)


_EVENTS = ((bpy.app.handlers.depsgraph_update_post, _on_edit), (bpy.app.handlers.render_init, _before_render))


def register() -> None:
    """Follow edits and renders."""
    events.follow(_EVENTS)


def unregister() -> None:
    """Stop following them."""
    events.stop(_EVENTS, [_sync_later])
