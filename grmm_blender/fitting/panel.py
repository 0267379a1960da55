"""The panel "Avatar from Photos" in the sidebar: photos, their faces, preset, progress."""

from __future__ import annotations

import bpy

from ..panels.twins import CATEGORY
from ..progress_bar import draw_progress
from ..rig.avatar import avatar_of
from ..width import draw_text, is_narrow
from . import watch
from .provenance import provenance_sentence
from .settings import GRMM_FitPhoto, GRMM_FitSettings, can_go_on, settings

_PICTURE_SCALE = 9.0


class GRMM_UL_fit_photos(bpy.types.UIList):
    """List of photos with the number of faces found."""

    bl_idname = "GRMM_UL_fit_photos"

    def draw_item(
        self, _context: bpy.types.Context, layout: bpy.types.UILayout, _data: object, item: GRMM_FitPhoto, _icon: int,
        _active: object, _property: str,
    ) -> None:  # fmt: skip
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
        choices = settings(context)
        running = watch.is_running()
        column = layout.column()
        column.enabled = not running
        self._photos(column, choices)
        if running:
            self._progress(layout)
        elif len(choices.photos):
            self._start(layout, choices)
        if watch.note() and not running:
            draw_text(layout, watch.note(), context)
            if watch.waits_to_be_added():
                layout.operator("grmm.fit_add_to_scene", icon="OUTLINER_OB_ARMATURE")
        avatar = avatar_of(context.object)
        provenance = "" if avatar is None else provenance_sentence(avatar.source)
        if provenance:
            box = layout.box()
            draw_text(box, provenance, context, icon="INFO")
            box.operator("grmm.fit_photo_expression", icon="LOOP_BACK")

    def _photos(self, layout: bpy.types.UILayout, choices: GRMM_FitSettings) -> None:
        row = layout.row()
        row.template_list(GRMM_UL_fit_photos.bl_idname, "", choices, "photos", choices, "active", rows=2)
        buttons = row.column(align=True)
        buttons.operator("grmm.fit_add_photos", text="", icon="ADD")
        buttons.operator("grmm.fit_remove_photo", text="", icon="REMOVE")
        if not len(choices.photos):
            layout.label(text="Only of people who agreed", icon="INFO")
            return
        photo = choices.photos[min(choices.active, len(choices.photos) - 1)]
        icon = watch.icon_of(photo.faces_picture)
        if icon:
            layout.template_icon(icon, scale=_PICTURE_SCALE)
        layout.prop(photo, "mask")
        if max(item.faces for item in choices.photos) > 1 or choices.face > 1:
            layout.prop(choices, "face")
        layout.prop(choices, "preset")
        layout.prop(choices, "output")

    def _start(self, layout: bpy.types.UILayout, choices: GRMM_FitSettings) -> None:
        column = layout.column(align=True)
        column.operator("grmm.fit_find_faces", icon="VIEWZOOM")
        column.operator("grmm.fit_photos", icon="OUTLINER_OB_ARMATURE").resume = False
        if can_go_on(choices):
            column.operator("grmm.fit_photos", text="Resume", icon="FILE_REFRESH").resume = True

    def _progress(self, layout: bpy.types.UILayout) -> None:
        progress = watch.job().status.progress
        draw_progress(layout, progress, watch.stages())
        icon = watch.icon_of(progress.picture)
        if icon:
            layout.label(text="Photo and avatar")
            layout.template_icon(icon, scale=_PICTURE_SCALE)
        layout.operator("grmm.fit_cancel", icon="CANCEL")


CLASSES = (GRMM_UL_fit_photos, GRMM_PT_fit)
