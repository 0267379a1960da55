"""`python -m tools.grooms`: rebuild the grooms of `grmm_core/assets/grooms` with the studio's generator, on the mean head.

One for each style but bald; a minute or two. Needs scipy, not bpy.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from grmm_core.files.access import atomic_write
from grmm_core.hair.compact import compact
from grmm_core.hair.packaged import GROOM_FOLDER, GROOM_SUFFIX
from grmm_core.hair.roots import SCALP
from grmm_core.hair.strands import points_needed
from grmm_core.head import load_open_head
from grmm_studio.grooming import make_groom
from grmm_studio.mesh import RenderMesh
from grmm_studio.styles import STYLES
from grmm_studio.subjects import SHAPE_COUNT, draw_subject

STRANDS = 7000
MAX_BYTES = 430_000  # of one before it is compressed: all of them together stay below 8 MB
CURL = 0.35  # a person's own, where a style has one
# styles are cut differently on women; these are a woman's
WOMENS = (
    "afro",
    "bob",
    "braids",
    "bun",
    "curly",
    "fringe",
    "layered",
    "locs",
    "long",
    "pixie",
    "ponytail",
    "ringlets",
    "wavy_long",
)


def main() -> int:
    """Write the files."""
    head = load_open_head()
    mesh = RenderMesh.build(head)
    someone = draw_subject(1, 0, None)
    shape = np.zeros(SHAPE_COUNT, np.float32)
    neutral = np.asarray(head.vertices(shape, np.zeros(1), np.zeros((5, 3))), float)
    GROOM_FOLDER.mkdir(exist_ok=True)
    for name in STYLES:
        subject = replace(
            someone, shape=shape, hair_style=name, hair_length=1.0, hair_curl=CURL, hair_volume=1.0, hairline=0.0, part=0.5,
            macros={**someone.macros, "female": float(name in WOMENS), "age": 30.0}, beard=0.0, stubble=0.0,
        )  # fmt: skip
        groom = make_groom(head, mesh, neutral, subject)
        groom = groom.select(groom.groups == SCALP)
        arrays = compact(groom.level(min(1.0, STRANDS / len(groom))), MAX_BYTES, points_needed(groom))
        path = GROOM_FOLDER / f"{name}{GROOM_SUFFIX}"
        with atomic_write(path) as file:
            np.savez_compressed(file, **arrays)
        sys.stdout.write(f"{path}: {len(arrays['groups'])} strands, {path.stat().st_size >> 10} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
