"""`python -m tools.grooms [PART or STYLE...]`: rebuild `grmm_core/assets/grooms` by the studio's generators, on the mean head.

For the scalp one for each style but bald, a minute or two; brows, beards and lashes by `FACE`. Of the many strands that a
generator draws, those with evenly spread roots are kept: short hair of random roots is speckled. Needs scipy, not bpy.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from grmm_core.files.access import atomic_write
from grmm_core.hair.compact import compact
from grmm_core.hair.groom import Groom, bind, join
from grmm_core.hair.lashes import Lashes
from grmm_core.hair.packaged import GROOM_SUFFIX, groom_folder
from grmm_core.hair.roots import BEARD, BROWS, GROUPS, LASHES, SCALP
from grmm_core.hair.strands import points_needed
from grmm_core.head import HeadModel, load_open_head
from grmm_studio.grooming import make_groom
from grmm_studio.mesh import RenderMesh
from grmm_studio.styles import BALD, STYLES
from grmm_studio.subjects import SHAPE_COUNT, Subject, draw_subject

from .groom_finish import STRANDS, finished

MAX_BYTES = 427_000  # of one before it is compressed: all of them together stay below 9 MB
BEARD_STRANDS, BEARD_DRAWS = 9000, 8
LIP, BESIDE_LIPS = (0.028, -0.028), 0.5  # metres beside the middle, and height, of an upper lip; share of hairs elsewhere
CHIN = (0.070, 0.082)  # metres before the head's middle: a goatee ends behind the second and is gone before the first
CURL = 0.35  # a person's own, where a style has one
LASH_COUNTS, LASH_POINTS = (130, 56), 6  # of an upper and a lower lid; of a lash
LASH_WIDTH = 0.75  # of the studio's, which grows fewer
LASH_CLUSTER = 3.5  # lashes whose tips join, in the mean: fewer or more at random, for a comb of equal ones is drawn with a pen
LASH_LENGTHS = (0.003, 0.0045, 0.0062, 0.0055)  # metres of upper lashes at four places: without mascara they hardly show
# where the package's grooms differ from the studio's: braids so many that no crown is bare between them, curls that hold
# together, since hair of many directions in one place is seen as a weave; locs of enough points to be seen wound, and fewer,
# so that they are told apart; shorn hair that lies one way, since skin shows where it does not, and covers as much as that of
# a head; combed hair without ridges, ends that are not all points
_SHORN: dict[str, Any] = {"messiness": 0.09, "width": 0.00017}
_CROPPED: dict[str, Any] = {"messiness": 0.12, "width": 0.00018, "clumping": 0.3}
_COMBED: dict[str, Any] = {"comb": "swept", "clumping": 0.35, "messiness": 0.035, "hug": 0.8, "flyaway": 0.008}
_FALLING: dict[str, Any] = {"clumping": 0.42}
_WOUND: dict[str, Any] = {"messiness": 0.06, "frizz": 0.0002, "wavelength": 0.055, "points": 36}
CHANGES: dict[str, dict[str, Any]] = {
    "stubble": _SHORN,
    "buzz": _SHORN,
    "crop": _CROPPED,
    "receding": _CROPPED,
    "fade": {**_CROPPED, "messiness": 0.2},
    "mohawk": {"messiness": 0.12, "width": 0.00017},
    "slick_back": _COMBED,
    "undercut": {**_COMBED, "length": 0.095, "width": 0.00017},
    "side_part": {"comb": "side"},
    "pixie": {"comb": "side"},
    "bob": _FALLING,
    "long": _FALLING,
    "chest_length": _FALLING,
    "curtains": _FALLING,
    "layered": {"clumping": 0.5},
    "braids": {"clumps": 300, "rope": 0.0027, "clearance": 0.004, "lift": 0.25, "hug": 0.7, "puff": 0.004, "wound": 0.3},
    "locs": {"clumps": 210, "rope": 0.0037, "lift": 0.3, "hug": 0.7, "puff": 0.004, "wound": 0.2, **_WOUND},
    "ringlets": {"clumps": 260, "clumping": 0.95, "curl_spread": 0.12, "gather": 0.2},
}
# styles are cut differently on women; these are a woman's
WOMENS = (
    "afro",
    "bob",
    "braids",
    "bun",
    "chest_length",
    "chest_waves",
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


# what a person must be for a groom of brows, beard or lashes
FACE: dict[int, dict[str, dict[str, Any]]] = {
    BROWS: {
        "thin": {"brow_thickness": 0.65, "brow_density": 0.9, "brow_arch": 1.3},
        "natural": {"brow_thickness": 1.0, "brow_density": 1.0, "brow_arch": 0.8},
        "bushy": {"brow_thickness": 1.4, "brow_density": 1.3, "brow_arch": 0.5},
    },
    BEARD: {
        "stubble": {"stubble": 0.8},
        "short": {"stubble": 1.0, "beard": 0.006},
        "full": {"stubble": 1.0, "beard": 0.020},
        "goatee": {"stubble": 1.0, "beard": 0.012, "beard_cut": "goatee"},
        "moustache": {"stubble": 1.0, "beard": 0.012, "beard_cut": "moustache"},
        "chinstrap": {"stubble": 1.0, "beard": 0.005, "beard_cut": "chinstrap"},
    },
    LASHES: {"natural": {"lash_density": 4.0}},
}


def _people(someone: Subject, wanted: set[str]) -> Iterator[tuple[int, str, Subject]]:
    """Part, name and wearer of each groom of the parts and styles that are wanted."""
    for name in STYLES if GROUPS[SCALP] in wanted else wanted.intersection(STYLES):
        macros = {**someone.macros, "female": float(name in WOMENS), "age": 30.0}
        yield SCALP, name, replace(someone, hair_style=name, macros=macros)
    for group, rows in FACE.items():
        for name, values in rows.items() if GROUPS[group] in wanted else ():
            yield group, name, replace(someone, **values)


def change_styles() -> None:
    """Have the studio's generators draw hair as the package has it, from now on."""
    for name, values in CHANGES.items():
        STYLES[name] = replace(STYLES[name], **values)


def grown(head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, group: int, subject: Subject) -> Groom:
    """One part of the hair of somebody with the mean head; a beard drawn several times over, as dense as beards are."""
    found: list[Groom] = []
    while not found or (group == BEARD and sum(map(len, found)) < BEARD_STRANDS and len(found) < BEARD_DRAWS):
        groom = make_groom(head, mesh, neutral, replace(subject, index=len(found)))
        on_ear = np.isin(np.asarray(head.faces)[groom.triangles], head.regions["ears"]).any(1)
        own = (groom.groups == group) & (~on_ear | (group not in (SCALP, BEARD)))
        if group == BEARD and subject.beard_cut == "goatee":
            own &= _before_throat(groom, neutral, head)
        elif group == BEARD and subject.beard > 0.0 and subject.beard_cut == "full":
            own &= _dense_on_lips(groom, neutral, head)
        found.append(groom.select(own))
    groom = join(found)
    if group == LASHES:
        return _fanned(groom, neutral, head)
    return finished(groom, neutral, head, subject.hair_style) if group == SCALP else groom


def _before_throat(groom: Groom, vertices: np.ndarray, head: HeadModel) -> np.ndarray:
    """Strands that stand on a chin, not below the jaw or on the throat: the studio's goatees go on down these, [N] bool."""
    depth = groom.frames(vertices, head.faces).at(vertices)[0][:, 2]
    return _some(np.interp(depth, CHIN, (0.0, 1.0)))


def _dense_on_lips(groom: Groom, vertices: np.ndarray, head: HeadModel) -> np.ndarray:
    """Strands of a whole beard, fewer but on the upper lip, whose short hairs do not lie over one another, [N] bool."""
    places = groom.frames(vertices, head.faces).at(vertices)[0]
    lip = (np.abs(places[:, 0]) < LIP[0]) & (places[:, 1] > LIP[1])
    return _some(np.where(lip, 1.0, BESIDE_LIPS))


def _some(shares: np.ndarray) -> np.ndarray:
    """As many of each as shares [N] say, evenly among neighbours in number, [N] bool."""
    kept: np.ndarray = (np.arange(len(shares)) * 0.6180339887498949) % 1.0 < shares
    return kept


def _fanned(groom: Groom, vertices: np.ndarray, head: HeadModel) -> Groom:
    """Some `LASH_COUNTS` lashes, evenly spread along their lids, that go out from the eyeball as a fan and bend away from it.

    The cards of the head model lead them across the eye.
    """
    built = Lashes.build(head, vertices, groom)
    assert built is not None  # it was grown on the cards
    roots = built.edge_points(vertices)
    points, kept, g = np.zeros((len(groom), LASH_POINTS, 3)), [], np.random.default_rng(7)
    t = np.linspace(0.0, 1.0, LASH_POINTS)[:, None]
    for eyeball, side in (("left_eyeball", 1), ("right_eyeball", -1)):
        middle = vertices[head.regions[eyeball]].mean(0)
        assert middle[0] * side > 0.0
        for upper, count in zip((True, False), LASH_COUNTS, strict=True):
            own = np.flatnonzero((built.upper == upper) & (built.sides == side))
            place = np.abs(roots[own, 0])
            place = (place - place.min()) / np.ptp(place)
            wanted = (np.arange(count) + g.uniform(0.2, 0.8, count)) / count
            chosen = np.unique(np.abs(place[:, None] - wanted).argmin(0))
            own, place = own[chosen], place[chosen]
            cluster = np.cumsum(g.random(len(own)) < 1.0 / LASH_CLUSTER)
            shared = g.normal(size=(len(own) + 1, 5))[cluster]
            long = np.interp(place, (0.0, 0.2, 0.65, 1.0), LASH_LENGTHS) * (0.97 + 0.1 * shared[:, 3])
            long *= 1.0 - 0.55 * g.beta(0.8, 2.4, len(own))  # new ones grow between those that are long
            way = roots[own] - middle
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            way[:, 0] += side * 0.3 * place
            middles = np.array([roots[own[cluster == number]].mean(0) for number in cluster])
            way += 0.09 * shared[:, :3] + 0.04 * g.normal(size=(len(own), 3))
            bend = np.array([0.0, 1.0, 0.0]) * t**2 * ((0.45 if upper else -0.35) * (1.0 + 0.25 * shared[:, 4]))[:, None, None]
            scale = (long if upper else 0.5 * long)[:, None, None]
            joined = 0.5 * t**1.5 * (middles - roots[own])[:, None]
            points[own] = roots[own, None] + joined + scale * (0.85 * t * way[:, None] + bend)
            kept.append(own)
    rows = np.sort(np.concatenate(kept))
    some = groom.select(rows)
    return bind(
        head.v_template, head.faces, vertices, some.triangles, some.weights, points[rows].reshape(-1, 3),
        np.arange(len(rows) + 1) * LASH_POINTS, LASH_WIDTH * some.widths, some.groups,
    )  # fmt: skip


def _write(group: int, name: str, groom: Groom) -> None:
    most = BEARD_STRANDS if group == BEARD else STRANDS
    arrays = compact(groom.level(min(1.0, most / len(groom))), MAX_BYTES, points_needed(groom))
    path = groom_folder(GROUPS[group]) / f"{name}{GROOM_SUFFIX}"
    path.parent.mkdir(exist_ok=True)
    with atomic_write(path) as file:
        np.savez_compressed(file, **arrays)
    sys.stdout.write(f"{path}: {len(arrays['groups'])} strands, {path.stat().st_size >> 10} kB\n")


def average_person(head: HeadModel) -> tuple[Subject, np.ndarray]:
    """Somebody with the mean head, no hair but brows and lashes, and the head's vertices."""
    shape = np.zeros(SHAPE_COUNT, np.float32)
    someone = replace(
        draw_subject(1, 0, None), shape=shape, hair_style=BALD, hair_length=1.0, hair_curl=CURL, hair_volume=1.0, hairline=0.0,
        part=0.5, beard=0.0, stubble=0.0, beard_cut="full", brow_height=0.0,
    )  # fmt: skip
    return someone, np.asarray(head.vertices(shape, np.zeros(1), np.zeros((5, 3))), float)


def main() -> int:
    """Write the files."""
    change_styles()
    head = load_open_head()
    mesh = RenderMesh.build(head)
    someone, neutral = average_person(head)
    for group, name, subject in _people(someone, set(sys.argv[1:] or GROUPS)):
        _write(group, name, grown(head, mesh, neutral, group, subject))
    return 0


if __name__ == "__main__":
    sys.exit(main())
