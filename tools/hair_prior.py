"""`python -m tools.hair_prior [GROOMS]`: learn the prior over hairstyles from the capture studio's styles.

Styles are grown on the mean head with all that persons differ in drawn from seeds; a tenth is held out and measured. Writes
`grmm_core/assets/hair_prior.npz`. Some minutes. Needs scipy, not bpy.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from grmm_core.files.access import atomic_write
from grmm_core.hair.grids import nearest
from grmm_core.hair.groom import Groom
from grmm_core.hair.prior import (
    NEAR,
    POINTS,
    PRIOR_FILE,
    STRAND_POINTS,
    Description,
    HairPrior,
    between,
    described,
    mixed,
)
from grmm_core.hair.strands import evened, smoothed
from grmm_core.head import HeadModel, load_open_head
from grmm_studio.fields import scalp_density
from grmm_studio.grooming import scalp_hairs
from grmm_studio.grooms import KNOTS
from grmm_studio.mesh import RenderMesh
from grmm_studio.styles import STYLES
from grmm_studio.subjects import Subject

from .groom_finish import OVER_BACK
from .grooms import average_person

GROOMS = 320
SHARE = 0.07  # of a style's strands that are grown
GUIDES = 700
COMPONENTS = 36
# what hangs from a knot grows nowhere else, and what lies on the back no further than the bust goes
STYLES_LEARNED = tuple(name for name, style in STYLES.items() if name not in KNOTS and style.length < OVER_BACK)
HELD_OUT = 10  # each tenth


def _people(someone: Subject, count: int) -> Iterator[Subject]:
    """Persons of the mean head who differ in hair."""
    for index in range(count):
        g = np.random.default_rng([5, index])
        macros = {**someone.macros, "female": float(g.integers(2)), "age": float(g.uniform(20, 70))}
        yield replace(
            someone, index=index, hair_style=STYLES_LEARNED[index % len(STYLES_LEARNED)], macros=macros,
            hair_length=float(g.uniform(0.7, 1.3)), hair_curl=float(g.beta(1.2, 2.0)), hair_volume=float(g.uniform(0.7, 1.4)),
            hairline=float(g.normal(0, 0.003)), part=float(g.uniform(0.42, 0.58)),
        )  # fmt: skip


def _guides(head: HeadModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles and weights of guides, evenly over where hair grows, and how dense it grows at each vertex, uint8."""
    faces, template = np.asarray(head.faces), np.asarray(head.v_template, float)
    growth = scalp_density(template, 0.0, 0.0, 1)
    growth[faces[np.asarray(head.uv_islands) != 0]] = 0.0
    growth[head.regions["ears"]] = 0.0
    hairy = growth[faces].max(1) > 0.05
    among = np.flatnonzero(hairy)
    corners = template[faces[among]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    g = np.random.default_rng(3)
    chosen = g.choice(len(among), 12 * GUIDES, p=area / area.sum())
    a, b = np.sqrt(g.random(len(chosen))), g.random(len(chosen))
    weights = np.stack([1 - a, a * (1 - b), a * b], 1)
    places = (corners[chosen] * weights[..., None]).sum(1)
    kept, far = [0], np.full(len(places), np.inf)
    for _ in range(GUIDES - 1):  # the farthest from all that are there
        far = np.minimum(far, ((places - places[kept[-1]]) ** 2).sum(1))
        kept.append(int(far.argmax()))
    return among[chosen[kept]], weights[kept], np.round(255 * growth).astype(np.uint8)


def _off(prior: HairPrior, strands: np.ndarray, known: Description) -> tuple[float, float]:
    """Mean distance in mm of guides from those of their code, and of strands from strands between these guides."""
    again = prior.describe(prior.code_of(known))
    sure = known.density > 0.5
    guides = np.linalg.norm(again.guides - known.guides, axis=2)[sure].mean()
    order, near = nearest(prior.places, strands[:, 0], NEAR)
    found = between(again.guides, order, mixed(again.guides, order, near))
    own = evened(smoothed(strands), POINTS)[:, 1:] - strands[:, :1]
    return 1e3 * float(guides), 1e3 * float(np.linalg.norm(found - own, axis=2).mean())


def _strands(head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, subject: Subject) -> np.ndarray | None:
    hairs = scalp_hairs(head, mesh, neutral, subject, SHARE)
    if hairs is None or len(hairs.points) < 400:
        return None
    count, steps = hairs.points.shape[:2]
    even = Groom(
        np.zeros(count, np.int32), np.zeros((count, 3)), np.arange(count + 1) * steps, hairs.points.reshape(-1, 3),
        np.zeros((count, 2)), np.zeros(count, np.uint8),
    ).resampled(STRAND_POINTS)  # fmt: skip
    return even.points.reshape(count, STRAND_POINTS, 3).astype(float)


def main() -> int:
    """Write the file and say how far held-out grooms are."""
    head = load_open_head()
    mesh = RenderMesh.build(head)
    someone, neutral = average_person(head)
    triangles, weights, growth = _guides(head)
    corners = np.asarray(head.v_template, float)[np.asarray(head.faces)[triangles]]
    places = (corners * weights[..., None]).sum(1)
    known, held = [], []
    for index, subject in enumerate(_people(someone, int(sys.argv[1]) if len(sys.argv) > 1 else GROOMS)):
        strands = _strands(head, mesh, neutral, subject)
        if strands is None:
            continue
        row = described(places, strands)
        if index % HELD_OUT == 0:
            held.append((subject.hair_style, strands, row))
        else:
            known.append(row.vector())
    rows = np.stack(known)
    mean = rows.mean(0)
    u, s, v = np.linalg.svd(rows - mean, full_matrices=False)
    basis = v[:COMPONENTS] * (s[:COMPONENTS, None] / np.sqrt(len(rows)))
    step = np.abs(basis).max(1) / 127
    whole = np.round(basis / step[:, None]).astype(np.int8)
    codes = (u[:, :COMPONENTS] * np.sqrt(len(rows))).astype(np.float16)
    with atomic_write(PRIOR_FILE) as file:
        np.savez_compressed(
            file, triangles=triangles.astype(np.int32), weights=weights.astype(np.float32), growth=growth,
            mean=mean.astype(np.float16), basis=whole, basis_step=step.astype(np.float32), codes=codes,
        )  # fmt: skip
    prior = HairPrior(triangles, weights, growth / 255.0, mean, whole * step[:, None], codes.astype(float), head)
    sys.stdout.write(
        f"{PRIOR_FILE}: {len(rows)} grooms, {COMPONENTS} components hold {(s[:COMPONENTS] ** 2).sum() / (s**2).sum():.3f}, "
        f"{PRIOR_FILE.stat().st_size >> 10} kB\n"
    )
    for style, strands, row in held:
        guides, each = _off(prior, strands, row)
        size = 1e3 * float(np.linalg.norm(row.guides[:, -1], axis=1).mean())
        sys.stdout.write(f"held out, {style}: guides {guides:.1f} mm off, strands {each:.1f}, of a mean length of {size:.0f}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
