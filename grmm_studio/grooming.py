"""The groom of one person: scalp hair, brows, beard and lashes, bound to the head's triangles. Needs numpy and scipy."""

from __future__ import annotations

import numpy as np

from grmm_core.hair.groom import Groom, bind, join
from grmm_core.hair.roots import BEARD, BROWS, LASHES, SCALP
from grmm_core.head import HeadModel
from grmm_core.wrinkles.noise import smoothstep

from .face_hair import Hairs, beard, brows, lashes
from .fields import scalp_density
from .grooms import KNOTS, growth_of, tail_points
from .hair import Roots, Skull, grow, resample, shortened, skin_triangles
from .mesh import RenderMesh
from .subjects import Subject


def make_groom(head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, subject: Subject, share: float = 1.0) -> Groom:
    """All strands of a person on the neutral head [V, 3]; `share` of the scalp's strands."""
    g = np.random.default_rng([subject.seed, subject.index, 22])
    parts = [
        (SCALP, scalp_hairs(head, mesh, neutral, subject, share)), (BROWS, brows(head, mesh, neutral, subject, g)),
        (BEARD, beard(head, mesh, neutral, subject, g)), (LASHES, lashes(head, neutral, subject, g)),
    ]  # fmt: skip
    return join([_bound(head, neutral, hairs, group) for group, hairs in parts if hairs is not None and len(hairs.triangles)])


def _bound(head: HeadModel, neutral: np.ndarray, hairs: Hairs, group: int) -> Groom:
    count, steps = hairs.points.shape[:2]
    return bind(
        head.v_template, head.faces, neutral, hairs.triangles, hairs.weights, hairs.points.reshape(-1, 3),
        np.arange(count + 1) * steps, hairs.widths, np.full(count, group),
    )  # fmt: skip


def scalp_hairs(head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, subject: Subject, share: float = 1.0) -> Hairs | None:
    """Scalp hair on the neutral head [V, 3], by the person's style; None for the bald."""
    growth = growth_of(subject)
    if growth is None:
        return None
    g = np.random.default_rng([subject.seed, subject.index, 21])
    template = np.asarray(head.v_template, float)

    def density(rest: np.ndarray) -> np.ndarray:
        return scalp_density(rest, growth.receding, subject.hairline, subject.asymmetry)

    among = skin_triangles(head, mesh)
    bound = density(template)[np.asarray(head.faces)].max(1)
    among = among[bound[among] > 0]
    count = int(growth.style.count * share * 1.15)
    roots = Roots.scatter(head, mesh, neutral, among, np.maximum(bound[among], 0.02), count, g)
    border = density(roots.rest)
    kept = g.random(count) < border / np.maximum(bound[roots.triangles], 0.02)
    roots, border = roots.select(kept), border[kept]
    points = grow(roots, growth, Skull(head, mesh, neutral), g)
    tied = subject.hair_style in KNOTS
    # baby hair: shorter strands at the border
    short = np.clip(0.35 + 0.65 * smoothstep(0.1, 0.9, border) + g.normal(0, 0.1, len(border)), 0.2, 1.0)
    if growth.curl_radius < 0.002 and not tied and not growth.style.rope:
        points = shortened(points, short)
    # nothing hangs in front of the throat or comes out of the chest
    stray = ((points[..., 2] > 0.025) & (points[..., 1] < -0.065) & (np.abs(points[..., 0]) < 0.055)).any(1)
    if growth.style.way == "hanging":  # nor does hair that is combed aside before the eyes
        x, y, z = np.abs(points[..., 0]), points[..., 1], points[..., 2]
        stray |= ((z > 0.05) & (y < 0.065) & (x < 0.062)).any(1)
    points, roots = points[~stray], roots.select(~stray)
    thickness = growth.style.width * np.clip(g.normal(1, 0.12, len(points)), 0.6, 1.4)
    hairs = Hairs(roots.triangles, roots.weights, points, thickness[:, None] * np.array([1.0, 0.45]))
    if not tied:
        return hairs
    tail = tail_points(subject, g, 2 * growth.style.points)
    tail = resample(tail, np.linspace(0, 1, tail.shape[1]), growth.style.points)
    knot = KNOTS[subject.hair_style]
    near = np.argsort(np.linalg.norm(template - knot, axis=1))[:12]
    moved = tail + (neutral[near] - template[near]).mean(0)
    nearest = among[int(np.argmin(np.linalg.norm(template[np.asarray(head.faces)[among]].mean(1) - knot, axis=1)))]
    return hairs.with_more(int(nearest), moved, growth.style.width * 1.1)
