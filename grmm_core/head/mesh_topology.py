"""Topology of triangle meshes: connected pieces, boundary loops, cuts along edges, paths. Index work only; needs numpy only.

Used by the FLAME loader (`flame_regions`, `flame_uv`), whose input is a mesh that the project has never seen.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable

import numpy as np


def components(faces: np.ndarray, count: int) -> np.ndarray:
    """Label of each vertex's connected piece, [count]; vertices without a triangle are pieces of their own."""
    label = np.arange(count)
    while True:
        low = label[faces].min(1)
        fresh = label.copy()
        for corner in range(3):
            np.minimum.at(fresh, faces[:, corner], low)
        fresh = fresh[fresh]  # short cuts: the number of passes grows with the logarithm of the diameter
        if (fresh == label).all():
            return label
        label = fresh


def directed_edges(faces: np.ndarray) -> np.ndarray:
    """Edges of all triangles in the order of their corners: all first edges, then all second, all third, [3 F, 2]."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Closed paths of edges that one triangle has alone, in the direction of that triangle; longest first."""
    edges = directed_edges(faces).astype(np.int64)
    base = int(faces.max()) + 1 if faces.size else 1
    alone = edges[~np.isin(edges[:, 0] * base + edges[:, 1], edges[:, 1] * base + edges[:, 0])]
    following: dict[int, list[int]] = defaultdict(list)
    for a, b in alone.tolist():
        following[a].append(b)
    loops = []
    for start in sorted(following):
        while following[start]:
            loop, vertex = [start], following[start].pop()
            while vertex != start and following[vertex]:
                loop.append(vertex)
                vertex = following[vertex].pop()
            loops.append(np.array(loop))
    return sorted(loops, key=len, reverse=True)


def cut_along(faces: np.ndarray, cut: Iterable[tuple[int, int]] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Give triangles vertices of their own unless they share an edge, directly or through their neighbours.

    Args:
        faces: [F, 3].
        cut: Undirected edges that no longer join their triangles.

    Returns:
        Triangles with new vertex numbers, [F, 3], and the old number of each new vertex.
    """
    count = len(faces)
    edges = directed_edges(faces).astype(np.int64)
    base = int(faces.max()) + 1
    low, high = edges.min(1), edges.max(1)
    key = low * base + high
    closed = {min(a, b) * base + max(a, b) for a, b in cut}
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    first, second = order[:-1][same], order[1:][same]
    if closed:
        kept = ~np.isin(key[first], np.array(sorted(closed)))
        first, second = first[kept], second[kept]
    # corner c of triangle f is node c * F + f; edge e = (c, f) starts at that node and ends at corner c + 1
    start, end = np.arange(3 * count), (np.arange(3 * count) + count) % (3 * count)

    def node(edge: np.ndarray, vertex: np.ndarray) -> np.ndarray:
        return np.where(edges[edge, 0] == vertex, start[edge], end[edge])

    joined = np.concatenate([
        np.stack([node(first, low[first]), node(second, low[first])], 1),
        np.stack([node(first, high[first]), node(second, high[first])], 1),
    ])  # fmt: skip
    label = components(np.concatenate([joined, joined[:, :1]], 1), 3 * count)
    unique, numbers = np.unique(label, return_inverse=True)
    return numbers.reshape(3, count).T.copy(), faces.T.reshape(-1)[unique]


def is_disk(faces: np.ndarray, loops: list[np.ndarray]) -> bool:
    """Whether a piece is a disk once all of its boundary loops but the longest are filled."""
    if not loops or any(len(np.unique(loop)) != len(loop) or len(loop) < 3 for loop in loops):
        return False
    edges = directed_edges(faces).astype(np.int64)
    base = int(faces.max()) + 1
    directed = edges[:, 0] * base + edges[:, 1]
    if len(np.unique(directed)) != len(directed):
        return False  # three triangles at an edge, or neighbours that turn differently
    undirected = len(np.unique(edges.min(1) * base + edges.max(1)))
    vertices = np.unique(faces)
    if len(vertices) - undirected + len(faces) != 2 - len(loops):
        return False
    return len(np.unique(components(faces, base)[vertices])) == 1


def shortest_path(edges: np.ndarray, cost: np.ndarray, start: int, goal: int) -> list[int] | None:
    """Vertices of the cheapest path along undirected edges [n, 2] of costs [n], or None where there is none."""
    neighbours: dict[int, list[tuple[int, float]]] = defaultdict(list)
    for (a, b), price in zip(edges.tolist(), cost.tolist(), strict=True):
        neighbours[a].append((b, price))
        neighbours[b].append((a, price))
    best, before = {start: 0.0}, {start: start}
    queue = [(0.0, start)]
    while queue:
        total, vertex = heapq.heappop(queue)
        if vertex == goal:
            path = [goal]
            while path[-1] != start:
                path.append(before[path[-1]])
            return path[::-1]
        if total > best[vertex]:
            continue
        for other, price in neighbours[vertex]:
            if total + price < best.get(other, np.inf):
                best[other], before[other] = total + price, vertex
                heapq.heappush(queue, (total + price, other))
    return None
