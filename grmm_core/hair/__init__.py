"""Hair as strands, which an animator can choose, color, cut and comb.

    groom = groom_from_curves(head, vertices, points, offsets, surface_uv, radii)   curves of a host, bound to the head
    settings = HairSettings(length=0.8, melanin=0.3, grey=0.2)                      sliders; `SETTINGS` lists them with ranges
    worn = session.put_groom("name", "version 1", groom)                            or "groom:bob", "own", "none"
    session.render([Instance(avatar.id, controls, hair=HairUse(worn, settings))], camera, options)   also session.gaussians
    session.save(avatar.id, "person.grmm", HairUse(worn, settings))                 the file holds the strands, in at most 1 MB

`groom_names` are the package's own grooms for the open head; `library_groom(name)` gives one as a `Groom`, whose `posed` points
a host can make curves of. A host that moves strands by itself (evaluated curves, a simulation) puts the groom once, at rest,
and gives each frame's points in `HairUse.points`, head space, in the groom's order: light inside the hair and levels of detail
come from the groom, places from the points. `AvatarInfo.hair` says what an opened avatar has of its own. The pass "hair" is the
cover of the strands. Wrong curves raise `ShapeError` with one sentence, before anything changes.

The map:
    groom.py      `Groom`, the record: roots on triangles, points in the root's frame, widths, groups; `bind`, `join`
    roots.py      frames at the roots that turn with the skin
    attach.py     `groom_from_curves`
    body.py       what strands stay outside of, with the hull of the ears
    lashes.py     lashes that go with their lids;  brows.py   brows at a person's height
    settings.py   `HairSettings`, `SETTINGS`
    compact.py    a groom in few bytes; packaged.py   the package's grooms
    prior.py      a code of few numbers that gives grooms between those seen; hair at random
    strands.py    a groom made ready: more strands, levels of detail, shape by settings;  ready.py   the last ones, kept
    occlusion.py  how much light reaches the inside;  crowding.py  and single strands;  pigment.py  colors of strands
    grids.py      values on cells, nearest points;  grid_kernels.py compiled
    ribbons.py    strands as Gaussians and their shading, readable; strand_kernels.py compiled; gradients.py for PyTorch
    drawing.py    all of it for one picture
    contact.py    strands brought out of a skin that has moved;  shoulders.py   long hair of a head that turns or bows
    swing.py      long hair that lags behind a moving head, and bakes of it; swing_kernel.py compiled
    mirror.py     the other way round;  coloring.py   pigments that look as in a picture, for captures and photos

The capture studio makes grooms and renders them; what draws or simulates hair reads the same record. Importing this package
needs numpy only; drawing needs numba.
"""

from __future__ import annotations

from .attach import groom_from_curves
from .groom import Groom, bind, join
from .packaged import groom_names, library_groom
from .settings import SETTINGS, HairSettings, Setting

__all__ = [
    "SETTINGS",
    "Groom",
    "HairSettings",
    "Setting",
    "bind",
    "groom_from_curves",
    "groom_names",
    "join",
    "library_groom",
]
