"""The render mesh: a smooth, finer mesh that passes through every vertex of the head model. Needs numpy only.

One step of Phong tessellation rounds the silhouette without moving the model's own vertices, so that the pictures stay
aligned to the parameters. Topology and attributes are made once per subject, positions once per shot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grmm_core.head import HeadModel

ROUNDNESS = 0.75  # of Phong tessellation
SKIN, EYE, TEETH, TONGUE = range(4)


def region_vertices(head: HeadModel, name: str) -> np.ndarray:
    """Vertex indices of a region, given as indices or as a mask; empty where the head has no such region."""
    region = head.regions.get(name)
    if region is None:
        return np.zeros(0, np.int64)
    region = np.asarray(region)
    return np.flatnonzero(region) if region.dtype == bool else region.astype(np.int64)


@dataclass
class RenderMesh:
    """Topology of the fine mesh.

    Attributes:
        coarse_faces: Faces of the model that are rendered (lash cards are not), [F', 3].
        kept: Their numbers among the model's faces, [F'].
        edges: Vertex pairs; vertex V + i of the fine mesh lies on edge i, [E, 2].
        faces: Fine triangles, [4 F', 3].
        materials: Material slot of each fine triangle, [4 F'].
    """

    coarse_faces: np.ndarray
    kept: np.ndarray
    edges: np.ndarray
    faces: np.ndarray
    materials: np.ndarray

    @staticmethod
    def build(head: HeadModel) -> RenderMesh:
        """Subdivide the head's topology."""
        slot = np.full(len(head.v_template), SKIN)
        for names, value in (
            (("left_eyeball", "right_eyeball"), EYE),
            (("upper_teeth", "lower_teeth"), TEETH),
            (("tongue",), TONGUE),
        ):
            for name in names:
                slot[region_vertices(head, name)] = value
        lashes = np.zeros(len(head.v_template), bool)
        lashes[region_vertices(head, "lashes")] = True
        coarse = np.asarray(head.faces)
        kept = np.flatnonzero(~lashes[coarse].all(1))
        coarse = coarse[kept]
        directed = np.concatenate([coarse[:, [0, 1]], coarse[:, [1, 2]], coarse[:, [2, 0]]])
        edges, inverse = np.unique(np.sort(directed, 1), axis=0, return_inverse=True)
        inverse = inverse.reshape(-1)
        count, n = len(coarse), len(head.v_template)
        ab, bc, ca = (n + inverse[i * count : (i + 1) * count] for i in range(3))
        a, b, c = coarse.T
        fine = np.stack([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))], 1)
        return RenderMesh(coarse, kept, edges, fine.reshape(-1, 3), np.repeat(slot[a], 4))

    def corner_uv(self, head: HeadModel) -> np.ndarray:
        """Texture coordinates of each corner of the fine triangles, [4 F' * 3, 2]."""
        a, b, c = (np.asarray(head.uv, float)[np.asarray(head.uv_faces)[self.kept, k]] for k in range(3))
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        fine = np.stack([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))], 1)
        return fine.reshape(-1, 2)

    def normals(self, vertices: np.ndarray) -> np.ndarray:
        """Area-weighted unit vertex normals of the model's vertices, [V, 3]."""
        p = vertices[self.coarse_faces]
        face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        flat = self.coarse_faces.ravel()
        total = np.stack([np.bincount(flat, np.repeat(face[:, k], 3), len(vertices)) for k in range(3)], 1)
        return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)

    def refine(self, vertices: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        """Fine positions [V + E, 3] of posed model vertices [V, 3]."""
        normals = self.normals(vertices) if normals is None else normals
        p, q = vertices[self.edges[:, 0]], vertices[self.edges[:, 1]]
        m, n = normals[self.edges[:, 0]], normals[self.edges[:, 1]]
        middle = 0.5 * (p + q)
        on_p = middle - ((middle - p) * m).sum(1, keepdims=True) * m
        on_q = middle - ((middle - q) * n).sum(1, keepdims=True) * n
        rounded = 0.5 * (on_p + on_q)
        return np.concatenate([vertices, middle + ROUNDNESS * (rounded - middle)])

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Vertex values [V, ...] linearly on the fine mesh, [V + E, ...]."""
        return np.concatenate([values, 0.5 * (values[self.edges[:, 0]] + values[self.edges[:, 1]])])
