"""Choosing hair by its picture: hair_choice.py WEIGHTS FOLDER. Reports what the test judges."""

from __future__ import annotations

import sys

import bpy
from panel_recorder import draw_all
from render_support import heads, new_scene, unpainted
from support import module, report

scene = new_scene(sys.argv[1])
head = heads(scene)[0]
hair = head.grmm.hair
packaged, grooms = module("grmm_core.hair.packaged"), module("grmm_blender.hair.grooms")
pictures = sorted(packaged.groom_folder().glob(f"*{packaged.PICTURE_SUFFIX}"))
names = packaged.groom_names()
menus: list[str] = []


class Layout:
    """Stands in for UILayout: notes menus."""

    def menu(self, name: str, **_: object) -> None:
        menus.append(name)

    def separator(self) -> None:
        pass

    def operator(self, name: str, **_: object) -> object:
        return type("Entry", (), {})()


class Menu:
    """Stands in for a menu that is drawn."""

    layout = Layout()


bpy.types.GRMM_MT_add.draw(Menu, bpy.context)
bpy.types.GRMM_MT_add_hair.draw(Menu, bpy.context)
own = module("grmm_blender.rig.identity").own_hair("default").settings
with unpainted():
    bpy.ops.grmm.add_head()
added = bpy.context.object.children[0].grmm.hair
names_of_settings = [row.name for row in module("grmm_core.hair").SETTINGS]
report(own=[[round(float(getattr(values, name)), 5) for name in names_of_settings] for values in (own, added)])
for part in (bpy.context.object.children[0], bpy.context.object):
    bpy.data.objects.remove(part)
bpy.context.view_layer.objects.active = head
wore = []
hair.picked = "afro"
wore.append(hair.groom)
bpy.ops.grmm.wear_hair(groom="bob")
wore.append(hair.groom)
wore.append(hair.picked)
bpy.ops.grmm.hair_as_curves(sculpt=False)
curves = hair.curves
hair.picked = "long"
gone = hair.curves is None and hair.groom == "long"
avatars = module("grmm_blender.scene.avatars")


def worn():
    """What the scene's avatar wears."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    avatar = avatars.avatars_in(scene)[0]
    return avatars.DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph).hair


def cover(beard: str) -> float:
    """Mean cover of strands where a chin is bare or has a beard."""
    host = module("grmm_blender.session_host")
    hair.beard = beard
    bpy.context.view_layer.update()
    return float(
        len(
            host.get_session()
            .gaussians(
                host.open_avatar(head.grmm.source).id,
                avatars.Avatar(head).controls(bpy.context.evaluated_depsgraph_get()),
                hair=worn(),
            )
            .means
        )
    )


dimmed = []
for dye in (0.0, 0.5, 1.0):
    hair.dye = dye
    dimmed.append([name for name in draw_all()["dimmed"] if name in names_of_settings])
hair.property_unset("dye")
report(dimmed=dimmed)
same = worn() is worn()
hair.groom, hair.seed, hair.brows = "RANDOM", 7, "bushy"
bpy.context.view_layer.update()
random = worn()
report(
    same=same,
    random=[random.groom, random.brows, random.beard, random.lashes],
    beard=[cover(name) for name in ("OWN", "NONE", "full")],
)
report(
    pictures=len([path for path in pictures if path.stem in (*names, "none")]),
    grooms=len(names),
    bytes=sum(path.stat().st_size for path in pictures),
    items=[name for name, *_ in grooms.HAIR_ITEMS][:3],
    numbers={item.identifier: item.value for item in hair.bl_rna.properties["groom"].enum_items},
    wore=wore,
    curves_gone=gone,
    still_there=curves.name in scene.objects,
    menus=menus,
)
