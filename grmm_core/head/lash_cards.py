"""The strips of a head model that stand for lashes: where they meet the skin is the edge of a lid. Needs numpy only."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .head_model import HeadModel

LASH_CARD_ROWS = 4  # quads across a lash card


@dataclass(frozen=True)
class LashCard:
    """One strip of the head model on which lashes stand.

    Attributes:
        root, tip: Vertices of the edge at the skin and of the outer edge, [C].
        triangles: Number of the triangle at each piece of the root edge, [C - 1].
        upper: Whether it is an upper lid's.
    """

    root: np.ndarray
    tip: np.ndarray
    triangles: np.ndarray
    upper: bool


def lash_edges(head: HeadModel) -> list[LashCard]:
    """The lash cards of a head.

    Cards are grids of `LASH_CARD_ROWS` quads across; the root edge is the long border that lies at the skin.
    """
    template = np.asarray(head.v_template, float)
    mask = np.zeros(len(template), bool)
    mask[head.regions["lashes"]] = True
    triangles = np.asarray(head.faces)
    numbers = np.flatnonzero(mask[triangles].all(1))
    triangles = triangles[numbers]
    other = np.ones(len(template), bool)
    for name in ("lashes", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue"):
        other[head.regions[name]] = False
    skin = template[other]
    parent = {int(v): int(v) for v in np.flatnonzero(mask)}

    def find(v: int) -> int:
        while parent[v] != v:
            parent[v] = parent[parent[v]]
            v = parent[v]
        return v

    for a, b, c in triangles.tolist():
        parent[find(a)] = find(b)
        parent[find(b)] = find(c)
    cards: dict[int, list[list[int]]] = {}
    for triangle in triangles.tolist():
        cards.setdefault(find(triangle[0]), []).append(triangle)
    result = []
    for faces in cards.values():
        uses = Counter(tuple(sorted((t[i], t[(i + 1) % 3]))) for t in faces for i in range(3))
        border = [edge for edge, count in uses.items() if count == 1]
        links: dict[int, list[int]] = {}
        for a, b in border:
            links.setdefault(a, []).append(b)
            links.setdefault(b, []).append(a)
        loop = [border[0][0]]
        previous = -1
        while True:
            following = [v for v in links[loop[-1]] if v != previous]
            previous = loop[-1]
            if following[0] == loop[0]:
                break
            loop.append(following[0])
        columns = (len(loop) - 2 * LASH_CARD_ROWS) // 2 + 1
        distance = np.array([np.linalg.norm(skin - template[v], axis=1).min() for v in loop])
        near = np.array(
            [
                np.roll(distance, -r)[:columns].sum()
                - np.roll(distance, -r)[columns + LASH_CARD_ROWS - 1 : 2 * columns + LASH_CARD_ROWS - 1].sum()
                for r in range(len(loop))
            ]
        )
        turned = np.roll(loop, -int(near.argmin()))
        root = np.asarray(turned[:columns])
        tip = np.asarray(turned[columns + LASH_CARD_ROWS - 1 : 2 * columns + LASH_CARD_ROWS - 1][::-1])
        upper = template[tip, 1].mean() > template[root, 1].mean()
        beside = [numbers[np.flatnonzero(np.isin(triangles, pair).sum(1) == 2)[0]] for pair in pairwise(root)]
        result.append(LashCard(root, tip, np.array(beside), bool(upper)))
    return result
