"""The panel "Avatar from Photos" in the sidebar: photos, what was found, preset, progress."""

from __future__ import annotations

import bpy

from ..panels.avatar_panels import CATEGORY
from ..panels.width import draw_text, is_narrow
from ..rig.avatar import avatar_of
from . import watch
from .origin import origin_of
from .settings import GRMM_FitSettings, can_go_on, settings

_PICTURE_SCALE = 9.0
_STAGES = {
    "": "Starting", "analyse": "Looking for faces", "track": "Tracking", "codes": "Finding the person",
    "decoders": "Fine detail",
}  # fmt: skip


class GRMM_UL_fit_photos(bpy.types.UIList):
    """List of photos with the number of faces found."""

    bl_idname = "GRMM_UL_fit_photos"

    def draw_item(self, _context, layout, _data, item, _icon, _active, _property, *_rest) -> None:  # noqa: ANN001, ANN002
        """Draw one photo."""
        row = layout.split(factor=0.7)
        row.label(text=bpy.path.basename(item.path) or "Choose a file", icon="IMAGE_DATA")
        if item.faces:
            row.label(text=f"{item.faces} face{'s' if item.faces > 1 else ''}")


class GRMM_PT_fit(bpy.types.Panel):
    """Make an avatar of the person in one or several photos."""

    bl_label = "Avatar from Photos"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY
    bl_order = 20
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender's form

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = not is_narrow(context)
        chosen = settings(context)
        running = watch.job() is not None and watch.job().running
        column = layout.column()
        column.enabled = not running
        self._photos(column, chosen)
        if running:
            self._progress(layout)
        elif len(chosen.photos):
            self._start(layout, chosen)
        if watch.note() and not running:
            draw_text(layout, watch.note(), context)
            if watch.finished():
                layout.operator("grmm.fit_use", icon="OUTLINER_OB_ARMATURE")
        avatar = avatar_of(context.object)
        said = "" if avatar is None else origin_of(avatar.source)
        if said:
            box = layout.box()
            draw_text(box, said, context, icon="INFO")
            box.operator("grmm.fit_photo_expression", icon="LOOP_BACK")

    def _photos(self, layout: bpy.types.UILayout, chosen: GRMM_FitSettings) -> None:
        row = layout.row()
        row.template_list(GRMM_UL_fit_photos.bl_idname, "", chosen, "photos", chosen, "active", rows=2)
        buttons = row.column(align=True)
        buttons.operator("grmm.fit_add_photos", text="", icon="ADD")
        buttons.operator("grmm.fit_remove_photo", text="", icon="REMOVE")
        if not len(chosen.photos):
            layout.label(text="Only of people who agreed", icon="INFO")
            return
        photo = chosen.photos[min(chosen.active, len(chosen.photos) - 1)]
        icon = watch.icon_of(photo.found)
        if icon:
            layout.template_icon(icon, scale=_PICTURE_SCALE)
        layout.prop(photo, "mask")
        if max(item.faces for item in chosen.photos) > 1 or chosen.face > 1:
            layout.prop(chosen, "face")
        layout.prop(chosen, "preset")
        layout.prop(chosen, "output")

    def _start(self, layout: bpy.types.UILayout, chosen: GRMM_FitSettings) -> None:
        column = layout.column(align=True)
        column.operator("grmm.fit_look", icon="VIEWZOOM")
        column.operator("grmm.fit_photos", icon="OUTLINER_OB_ARMATURE").resume = False
        if can_go_on(chosen):
            column.operator("grmm.fit_photos", text="Resume", icon="FILE_REFRESH").resume = True

    def _progress(self, layout: bpy.types.UILayout) -> None:
        now = watch.status()
        text = _STAGES.get(now.stage, now.stage)
        if now.seconds_left is not None:
            text = f"{text}, about {_time(now.seconds_left)} left"
        layout.progress(factor=now.fraction, text=text)
        icon = watch.icon_of(now.preview)
        if icon:
            layout.label(text="Photo and avatar")
            layout.template_icon(icon, scale=_PICTURE_SCALE)
        layout.operator("grmm.fit_cancel", icon="CANCEL")


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


CLASSES = (GRMM_UL_fit_photos, GRMM_PT_fit)
