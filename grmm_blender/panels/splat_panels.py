"""The panel of imported splat clouds: where they come from, what moves them.

Stands in the sidebar's GRMM tab while a splat cloud is selected.
"""

from __future__ import annotations

import bpy

from ..splats.cloud import Cloud, is_cloud
from ..splats.rigged import is_puppet
from .twins import CATEGORY


class GRMM_PT_splats(bpy.types.Panel):
    """Where the splats come from and what moves them."""

    bl_label = "Splats"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With a splat cloud selected."""
        return is_cloud(context.object)

    def draw(self, context: bpy.types.Context) -> None:
        """Source, carrier, import and export."""
        layout = self.layout
        layout.use_property_split = True
        cloud = Cloud(context.object)
        settings = cloud.object.grmm_cloud
        layout.label(text=f"{cloud.count:,} splats", icon="OUTLINER_OB_POINTCLOUD")
        row = layout.row()
        row.enabled = False
        row.prop(settings, "source")
        if settings.carrier is not None:
            layout.prop(settings, "carrier")
        column = layout.column(align=True)
        if is_puppet(cloud.object):
            column.operator("grmm.import_performance", icon="ANIM_DATA")
        column.operator("grmm.export_splats", icon="EXPORT")


CLASSES = (GRMM_PT_splats,)
