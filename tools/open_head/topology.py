"""Which part of the base mesh the open head keeps, and the linear map from source vertices to its vertices.

Every vertex of the open head is a fixed affine mix of source vertices, so targets of the source carry over exactly:
`matrix @ source_offsets`. Parts come one after the other, each with vertices of its own: skin (with mouth interior), left
and right eyeball, upper and lower teeth, tongue, lashes.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from .source import Source

DECIMETRE = 0.1  # metres
BODY_VERTICES = 13380
# The bust is what lies inside this ellipsoid (decimetres, base mesh), or above its centre: upper shoulders, collar bones.
BUST_CENTRE = np.array([0.0, 6.25, 0.15])
BUST_RADII = np.array([1.45, 1.12, 1.9])
SNAP = 0.42  # an edge cut nearer than this to its end moves the end instead: no slivers
SOCKET_RING = 1.0  # in eyeball radii; only the fold inside the lids dips below this, the socket behind it is dropped


@dataclass
class Topology:
    """The open head's mesh and its relation to the source.

    Attributes:
        matrix: Affine mixing matrix, rows sum to 1, [V, N].
        faces: Triangles, counter-clockwise seen from outside, [F, 3].
        parts: Part name to vertex indices.
    """

    matrix: sparse.csr_matrix
    faces: np.ndarray
    parts: dict[str, np.ndarray]


def build_topology(source: Source) -> Topology:
    """Cut the bust, drop the sockets' backs, refine eyes and teeth, triangulate."""
    skin_matrix, skin_faces = _cut_bust(source)
    blocks: list[sparse.spmatrix] = [skin_matrix]
    faces = [skin_faces]
    parts = {"skin": np.arange(skin_matrix.shape[0])}
    plan = [
        ("left_eyeball", ["helper-l-eye"]), ("right_eyeball", ["helper-r-eye"]),
        ("upper_teeth", ["helper-upper-teeth"]), ("lower_teeth", ["helper-lower-teeth"]), ("tongue", ["helper-tongue"]),
        ("lashes", [f"helper-{side}-eyelashes-{row}" for side in "lr" for row in "12"]),
    ]  # fmt: skip
    count = skin_matrix.shape[0]
    for name, groups in plan:
        quads = np.concatenate([source.groups[group] for group in groups])
        used, local = np.unique(quads, return_inverse=True)
        matrix = sparse.csr_matrix((np.ones(len(used)), (np.arange(len(used)), used)), (len(used), len(source.vertices)))
        local = local.reshape(quads.shape)
        if name.endswith("eyeball") or name.endswith("teeth"):
            refine, local = catmull_clark(local, len(used))
            matrix = refine @ matrix
        if name.endswith("eyeball"):
            matrix = _on_sphere(matrix, source.vertices)
        blocks.append(matrix)
        faces.append(triangulate(local, matrix @ source.vertices) + count)
        parts[name] = np.arange(count, count + matrix.shape[0])
        count += matrix.shape[0]
    return Topology(sparse.vstack(blocks).tocsr(), np.concatenate(faces).astype(np.int32), parts)


def eyeball_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Least-squares sphere through points [n, 3]: centre [3] and radius, in the points' unit."""
    system = np.c_[2 * points, np.ones(len(points))]
    solution = np.linalg.lstsq(system, (points**2).sum(1), rcond=None)[0]
    return solution[:3], float(np.sqrt(solution[3] + solution[:3] @ solution[:3]))


def triangulate(polygons: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Split quads [Q, 4] along their shorter diagonal (a symmetric choice); -1 in the last column marks a triangle."""
    triangles = []
    for a, b, c, d in polygons:
        if d < 0:
            triangles.append((a, b, c))
        elif np.linalg.norm(vertices[a] - vertices[c]) <= np.linalg.norm(vertices[b] - vertices[d]):
            triangles += [(a, b, c), (a, c, d)]
        else:
            triangles += [(a, b, d), (b, c, d)]
    return np.array(triangles)


def catmull_clark(quads: np.ndarray, count: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """One Catmull-Clark step on a quad mesh with boundary: refinement matrix [n', count] and quads [4 Q, 4]."""
    edge_faces: dict[tuple[int, int], list[int]] = defaultdict(list)
    for f, quad in enumerate(quads):
        for i in range(4):
            edge_faces[_edge(quad[i], quad[(i + 1) % 4])].append(f)
    edge_index = {edge: count + len(quads) + i for i, edge in enumerate(edge_faces)}
    total = count + len(quads) + len(edge_index)
    matrix = sparse.lil_matrix((total, count))
    face_rows = np.zeros((len(quads), count))
    for f, quad in enumerate(quads):
        face_rows[f, quad] = 0.25
        matrix[count + f] = face_rows[f]
    faces_of, edges_of = defaultdict(list), defaultdict(list)
    for edge, adjacent in edge_faces.items():
        row = np.zeros(count)
        row[list(edge)] = 0.5
        if len(adjacent) == 2:
            row = 0.5 * row + 0.25 * (face_rows[adjacent[0]] + face_rows[adjacent[1]])
        matrix[edge_index[edge]] = row
        for vertex in edge:
            edges_of[vertex].append(edge)
    for f, quad in enumerate(quads):
        for vertex in quad:
            faces_of[vertex].append(f)
    for vertex in range(count):
        row = np.zeros(count)
        border = [edge for edge in edges_of[vertex] if len(edge_faces[edge]) == 1]
        if border:
            row[vertex] = 0.75
            for edge in border:
                row[edge[0] if edge[1] == vertex else edge[1]] += 0.125
        else:
            n = len(edges_of[vertex])
            middle = np.zeros(count)
            for edge in edges_of[vertex]:
                middle[list(edge)] += 0.5
            row = face_rows[faces_of[vertex]].mean(0) / n + 2 * middle / n**2
            row[vertex] += (n - 3) / n
        matrix[vertex] = row
    fine = []
    for f, quad in enumerate(quads):
        for i in range(4):
            following, previous = quad[(i + 1) % 4], quad[i - 1]
            fine.append((quad[i], edge_index[_edge(quad[i], following)], count + f, edge_index[_edge(previous, quad[i])]))
    return matrix.tocsr(), np.array(fine)


def _on_sphere(matrix: sparse.csr_matrix, vertices: np.ndarray) -> sparse.csr_matrix:
    """Push refined eyeball vertices back to their sphere, by affine mixing with the centroid."""
    points = matrix @ vertices
    centre, _ = eyeball_sphere(points)
    used = np.unique(matrix.indices)
    radius = np.linalg.norm(vertices[used] - centre, axis=1).mean()
    factor = radius / np.linalg.norm(points - centre, axis=1)
    middle = np.zeros((1, matrix.shape[1]))
    middle[0, used] = 1.0 / len(used)
    pull = sparse.csr_matrix((1.0 - factor)[:, None]) @ sparse.csr_matrix(middle)
    return (sparse.diags(factor) @ matrix + pull).tocsr()


def _cut_bust(source: Source) -> tuple[sparse.csr_matrix, np.ndarray]:
    body = source.groups["body"]
    vertices = source.vertices
    drop = np.zeros(len(vertices), bool)
    for side in "lr":
        drop |= _socket(source, f"helper-{side}-eye")
    body = body[~drop[body].any(1)]
    level = _bust_level(vertices)
    rows = sparse.identity(len(vertices), format="lil")
    # 1. ends of cut edges that are near the cut move onto it, along the edge whose crossing is nearest
    moved: dict[int, tuple[float, int]] = {}
    edges = {_edge(quad[i], quad[(i + 1) % 4]) for quad in body for i in range(4)}
    for a, b in edges:
        if level[a] * level[b] < 0:
            t = level[a] / (level[a] - level[b])
            for vertex, other, fraction in ((a, b, t), (b, a, 1 - t)):
                if fraction < SNAP and fraction < moved.get(vertex, (1.0, 0))[0]:
                    moved[vertex] = (fraction, other)
    for vertex, (fraction, other) in moved.items():
        rows[vertex, vertex] = 1 - fraction
        rows[vertex, other] = fraction
        level[vertex] = 0.0
    # 2. the remaining crossings get vertices of their own
    extra: list[sparse.spmatrix] = []
    crossing: dict[tuple[int, int], int] = {}
    polygons = []
    for quad in body:
        if (level[quad] <= 0).all() and (level[quad] < 0).any():
            polygons.append(list(quad))
            continue
        if not (level[quad] < 0).any():
            continue
        polygon = []
        for i in range(4):
            a, b = quad[i], quad[(i + 1) % 4]
            if level[a] <= 0:
                polygon.append(a)
            if level[a] * level[b] < 0:
                edge = _edge(a, b)
                if edge not in crossing:
                    crossing[edge] = len(vertices) + len(extra)
                    t = level[edge[0]] / (level[edge[0]] - level[edge[1]])
                    row = sparse.lil_matrix((1, len(vertices)))
                    row[0, edge[0]], row[0, edge[1]] = 1 - t, t
                    extra.append(row)
                polygon.append(crossing[edge])
        polygons.append(polygon)
    matrix = sparse.vstack([rows, *extra]).tocsr()
    positions = matrix @ vertices
    triangles = []
    for polygon in polygons:
        if len(polygon) <= 4:
            triangles.append(triangulate(np.array([[*polygon, -1][:4]]), positions))
        else:
            triangles.append(np.array([(polygon[0], polygon[i], polygon[i + 1]) for i in range(1, len(polygon) - 1)]))
    faces = np.concatenate(triangles)
    # keep the piece with the nose: the ellipsoid may touch the arms
    faces = _component(faces, int(np.argmax(np.where(np.arange(len(positions)) < BODY_VERTICES, positions[:, 1], -9))))
    used, local = np.unique(faces, return_inverse=True)
    return matrix[used], local.reshape(faces.shape)


def _bust_level(vertices: np.ndarray) -> np.ndarray:
    relative = (vertices - BUST_CENTRE) / BUST_RADII
    relative[:, 1] = np.minimum(relative[:, 1], 0.0)
    level = np.linalg.norm(relative, axis=1) - 1.0
    level[vertices[:, 1] > BUST_CENTRE[1]] = -1.0
    return level


def _socket(source: Source, eye: str) -> np.ndarray:
    """Mark the body's vertices behind the lids' inner fold, [N] bool."""
    vertices = source.vertices
    centre, radius = eyeball_sphere(vertices[np.unique(source.groups[eye])])
    distance = np.linalg.norm(vertices - centre, axis=1) / radius
    fold = distance < SOCKET_RING
    fold[BODY_VERTICES:] = False
    body = source.groups["body"]
    free = body[~fold[body].any(1)]
    start = int(np.argmin(np.linalg.norm(vertices[:BODY_VERTICES] - (centre - [0, 0, 1.07 * radius]), axis=1)))
    triangles = np.concatenate([free[:, [0, 1, 2]], free[:, [0, 2, 3]]])
    bag = np.zeros(len(vertices), bool)
    bag[np.unique(_component(triangles, start))] = True
    return bag


def _component(faces: np.ndarray, vertex: int) -> np.ndarray:
    """Return the faces connected to a vertex."""
    count = faces.max() + 1
    ones = np.ones(len(faces))
    ends = (np.r_[faces[:, 0], faces[:, 1]], np.r_[faces[:, 1], faces[:, 2]])
    graph = sparse.coo_matrix((np.r_[ones, ones], ends), (count, count))
    _, labels = csgraph.connected_components(graph, directed=False)
    return faces[labels[faces[:, 0]] == labels[vertex]]


def _edge(a: int, b: int) -> tuple[int, int]:
    return (int(a), int(b)) if a < b else (int(b), int(a))
