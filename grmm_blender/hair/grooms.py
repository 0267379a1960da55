"""The choice of hair: what there is, and a small picture of each, which Blender reads when it is shown for the first time."""

from __future__ import annotations

import bpy
import bpy.utils.previews

from ...grmm_core.hair import groom_names
from ...grmm_core.hair.packaged import PICTURE_SUFFIX, groom_folder

OWN_HAIR, NO_HAIR, RANDOM_HAIR = "OWN", "NONE", "RANDOM"  # besides the names of grooms
PARTS = ("brows", "beard", "lashes")  # chosen beside the hair
LATER = ("chest_length", "chest_waves")  # grooms that came when files had been saved, in this order; new ones go to the end


def label_of(name: str) -> str:
    """What people read for the name of a groom or of a setting."""
    return name.replace("_", " ").title()


HAIR_ITEMS = (
    (OWN_HAIR, "Own", "The hair that it comes with"),
    (NO_HAIR, "None", "A bald head"),
    *((name, label_of(name), f"Strands: {label_of(name).lower()}") for name in groom_names()),
    (RANDOM_HAIR, "Random", "Hair that nobody has combed: every seed is another"),
)
PART_ITEMS = {
    part: (
        (OWN_HAIR, "Own", f"The {part} that it comes with"),
        (NO_HAIR, "None", f"No {part} of strands"),
        *((name, label_of(name), f"Strands: {label_of(name).lower()}") for name in groom_names(part)),
    )
    for part in PARTS
}


def numbered(items: tuple[tuple[str, str, str], ...]) -> tuple[tuple[str, str, str, str, int], ...]:
    """Items with the numbers that files and keys hold, which do not change when grooms are added."""
    names = [name for name, *_ in items]
    order = [*(name for name in names if name not in LATER), *(name for name in LATER if name in names)]
    return tuple((*item, "NONE", order.index(item[0])) for item in items)


_pictures: bpy.utils.previews.ImagePreviewCollection | None = None


def icon_of(name: str) -> int:
    """Icon of a groom's picture by the groom's name, 0 where there is none or nothing is drawn."""
    path = groom_folder() / f"{name}{PICTURE_SUFFIX}"
    if _pictures is None or bpy.app.background or not path.is_file():
        return 0
    if name not in _pictures:
        _pictures.load(name, str(path), "IMAGE")
    return int(_pictures[name].icon_id)


def register() -> None:
    """Be ready to read pictures."""
    global _pictures
    _pictures = bpy.utils.previews.new()


def unregister() -> None:
    """Forget the pictures."""
    global _pictures
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
    _pictures = None
