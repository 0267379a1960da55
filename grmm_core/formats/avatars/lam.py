"""LAM: a zip of a mesh with ARKit morph targets (`skin.glb`) and a splat for each of its vertices (`offset.ply`).

Called by the Blender importer, which drives the morph targets. Needs numpy only.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...files.access import bad_file
from ...files.archive import member, read_members
from ...files.format import Format
from ..meshes.gltf_mesh import read_gltf_mesh
from ..meshes.mesh import Mesh
from ..splats.cloud import SH_C0, SplatCloud
from ..splats.ply import read_elements, splats_from_rows

KIND = "LAM archive"
_LIMIT = 1 << 30


@dataclass
class LamAvatar:
    """A LAM avatar: one splat a vertex of a mesh with ARKit morph targets.

    Attributes:
        mesh: Vertices, faces and morph targets by ARKit name.
        cloud: Splats at rest, in the order of the vertices.
    """

    mesh: Mesh
    cloud: SplatCloud

    def summary(self) -> dict[str, object]:
        """Facts for people: what `grmm info` shows."""
        return self.mesh.summary() | self.cloud.summary()

    def splats(self, weights: dict[str, float]) -> SplatCloud:
        """Splats with morph targets applied; unknown names do nothing."""
        moved = self.cloud.means.copy()
        for name, weight in weights.items():
            if weight and name in self.mesh.morphs:
                moved += np.float32(weight) * self.mesh.morphs[name]
        return replace(self.cloud, means=moved)


def read_lam(path: str | os.PathLike[str]) -> LamAvatar:
    """Read a LAM zip: `skin.glb` with morph targets, and `offset.ply` with a splat for every vertex in the same order.

    In `offset.ply` positions are offsets to the vertices and f_dc is plain RGB, no harmonic.

    Raises:
        FileFormatError: Damaged, a member is missing, or numbers of splats and vertices differ.
        FileAccessError: Missing or unreadable.
    """
    path = Path(path)
    contents = read_members(path, KIND, _LIMIT)
    mesh = read_gltf_mesh(path, member(path, KIND, contents, "skin.glb"))
    elements = read_elements(path, KIND, member(path, KIND, contents, "offset.ply")).elements
    cloud = splats_from_rows(path, elements["vertex"], KIND) if "vertex" in elements else None
    if cloud is None or cloud.count != mesh.vertices.shape[0]:
        found = 0 if cloud is None else cloud.count
        raise bad_file(path, KIND, f"it has {found} splats for {mesh.vertices.shape[0]} vertices")
    rgb = np.clip(cloud.sh[:, 0], 0.0, 1.0)
    cloud = replace(cloud, means=cloud.means + mesh.vertices, sh=((rgb - 0.5) / SH_C0)[:, None, :].astype(np.float32))
    return LamAvatar(mesh, cloud)


FORMAT = Format(
    "lam", "LAM (.zip)", "Splats on the vertices of a mesh with ARKit shapes", "avatar",
    (), read_lam, shared_suffixes=(".zip",),
)  # fmt: skip
