"""LAM: a zip of a mesh with ARKit morph targets (`skin.glb`) and a splat for each of its vertices (`offset.ply`).

Read by the Blender importer, which drives the morph targets; written for LAM's viewer in the browser (gaussian-splat-renderer-
for-lam 0.0.8). What that viewer asks for and does: the last folder entry of the zip names the folder of the files; `skin.glb`
has a skinned mesh, a joint called "hip", and one called "head" that moves every splat; `animation.glb` has its twelve clips by
their order alone; splat i moves by the morph targets of vertex i, which lie in one texture of 4096 x 2048; colors are plain RGB
without view dependence; its camera looks at a standing person's head. Needs numpy only.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import ShapeError
from ...files.access import atomic_write, bad_file
from ...files.archive import member, read_members
from ...files.format import Format
from ..glb import ELEMENT_BUFFER, GltfWriter
from ..meshes.gltf_mesh import add_morph_target, read_gltf_mesh
from ..meshes.mesh import Mesh
from ..splats.cloud import SH_C0, SplatCloud, clipped_colors, lost_harmonics
from ..splats.ply import ply_parts, read_elements, splats_from_rows

KIND = "LAM archive"
_LIMIT = 1 << 30
_FOLDER = "avatar/"
STANDING = 1.65
"""Metres from the ground to the middle of the head in these files."""
_FAR, _ABOUT = 0.5, 0.25  # metres: a middle so far from the origin is of somebody who stands; `STANDING` is right to about this
_MORPH_TEXELS = 4096 * 2048
_CLIPS = ("hello", "hello", "idle", *["speak"] * 6, *["think"] * 3)
_CLIP_SECONDS = 4.0
_SMALLEST_MOVE = 1e-5  # metres; what the learned residual moves less than a hundredth of a millimetre is not stored
_NECK = (0.0, -0.1, -0.02)  # where the head turns, metres from its middle
_HIP, _HEAD = 0, 1


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

    In `offset.ply` positions are offsets to the vertices and f_dc is plain RGB, no harmonic. The head is moved from the height
    of a standing person to head space.

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
    down = _standing(mesh.vertices)
    mesh = replace(mesh, vertices=mesh.vertices - down)
    rgb = np.clip(cloud.sh[:, 0], 0.0, 1.0)
    cloud = replace(cloud, means=cloud.means + mesh.vertices, sh=((rgb - 0.5) / SH_C0)[:, None, :].astype(np.float32))
    if down.any():
        cloud.warnings.append(
            f"In the file the head is {down[1]:.2f} m above the ground; it was moved to where heads are here."
        )
    return LamAvatar(mesh, cloud)


def _standing(vertices: np.ndarray) -> np.ndarray:
    """Where a head is whose vertices [V, 3] are at the height of a standing person, [3]; zero for one about the origin."""
    middle = (vertices.min(0) + vertices.max(0)) / 2.0
    usual = np.array([0.0, STANDING, 0.0], np.float32)
    if np.abs(middle).max() < _FAR:
        return np.zeros(3, np.float32)
    return usual if np.abs(middle - usual).max() < _ABOUT else middle


def write_lam(path: str | os.PathLike[str], avatar: LamAvatar) -> list[str]:
    """Write a zip that LAM's viewer opens.

    Args:
        path: The `.zip`.
        avatar: In head space. Its triangles matter to programs alone that show `skin.glb` as a mesh.

    Returns:
        What the format could not hold.

    Raises:
        ShapeError: Malformed, or more splats than the viewer's texture holds.
        FileAccessError: The file cannot be written.
    """
    mesh, cloud = avatar.mesh.validated(), avatar.cloud.validated()
    most = _MORPH_TEXELS // (len(mesh.morphs) + 1)
    if cloud.count != len(mesh.vertices):
        raise ShapeError(f"A LAM avatar needs a splat for each vertex; got {cloud.count} for {len(mesh.vertices)}.")
    if cloud.count > most:
        raise ShapeError(
            f"LAM's viewer holds {most} splats with {len(mesh.morphs)} shapes; reduce the {cloud.count} by a level."
        )
    rgb = np.clip(cloud.colors(), 0.0, 1.0).astype(np.float32)
    offsets = replace(cloud, means=cloud.means - mesh.vertices, sh=rgb[:, None])
    members = {
        "skin.glb": b"".join(_skin(mesh).parts()),
        "animation.glb": b"".join(_animation().parts()),
        "offset.ply": b"".join(ply_parts(offsets)),
        "vertex_order.json": json.dumps(list(range(cloud.count)), separators=(",", ":")).encode(),
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        archive.writestr(zipfile.ZipInfo(_FOLDER), b"")
        for name, data in members.items():
            archive.writestr(f"{_FOLDER}{name}", data)
    with atomic_write(path) as file:
        file.write(stream.getbuffer())
    return [*clipped_colors(cloud, 0.0, 1.0), *lost_harmonics(cloud)]


def _skin(mesh: Mesh) -> GltfWriter:
    """The mesh at a standing person's height, wholly bound to the head's joint."""
    writer, count = _skeleton(), len(mesh.vertices)
    faces = mesh.faces if mesh.faces is not None and len(mesh.faces) else vertex_triangles(count)
    joints, weights = np.zeros((count, 4), np.uint8), np.zeros((count, 4), np.float32)
    joints[:, 0], weights[:, 0] = _HEAD, 1.0
    up = np.array([0.0, STANDING, 0.0], np.float32)
    primitive = {
        "attributes": {
            "POSITION": writer.add_array(mesh.vertices + up, bounds=True),
            "JOINTS_0": writer.add_array(joints),
            "WEIGHTS_0": writer.add_array(weights),
        },
        "indices": writer.add_array(faces.reshape(-1), ELEMENT_BUFFER),
        "targets": [{"POSITION": add_morph_target(writer, delta, _SMALLEST_MOVE)} for delta in mesh.morphs.values()],
        "mode": 4,
    }
    inverse = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))  # a column is a row here, as glTF stores matrices
    inverse[_HEAD, 3, :3] = -(up + _NECK)
    names = {"weights": [0.0] * len(mesh.morphs), "extras": {"targetNames": list(mesh.morphs)}}
    entry = {"name": "head_mesh", "primitives": [primitive], **(names if mesh.morphs else {})}
    matrices = writer.add_array(inverse.reshape(2, 16), target=None)
    skin = writer.add("skins", {"joints": [_HIP, _HEAD], "skeleton": _HIP, "inverseBindMatrices": matrices})
    node = writer.add("nodes", {"name": "head_mesh", "mesh": writer.add("meshes", entry), "skin": skin})
    writer.document["scenes"][0]["nodes"].append(node)
    if not mesh.morphs:
        del primitive["targets"]
    return writer


def _animation() -> GltfWriter:
    """Clips in which the head rests, as many as the viewer distributes among what its person does."""
    writer = _skeleton()
    times = writer.add_array(np.array([0.0, _CLIP_SECONDS], np.float32), target=None, bounds=True)
    still = writer.add_array(np.tile(np.array([0, 0, 0, 1], np.float32), (2, 1)), target=None)
    for number, name in enumerate(_CLIPS):
        channel = {"sampler": 0, "target": {"node": _HEAD, "path": "rotation"}}
        entry = {"name": f"{name}_{number}", "samplers": [{"input": times, "output": still}], "channels": [channel]}
        writer.add("animations", entry)
    return writer


def _skeleton() -> GltfWriter:
    """A document with the two joints: the hip on the ground, and the head on it."""
    writer = GltfWriter()
    writer.add("nodes", {"name": "hip", "children": [_HEAD]})
    writer.add("nodes", {"name": "head", "translation": [float(at) for at in np.add(_NECK, (0.0, STANDING, 0.0))]})
    writer.add("scenes", {"nodes": [_HIP]})
    writer.document["scene"] = 0
    return writer


def vertex_triangles(count: int) -> np.ndarray:
    """Triangles [F, 3] that use each of so many vertices: a splat cloud has no surface, and the file needs one."""
    starts = np.minimum(np.arange(0, count, 3), max(count - 3, 0))
    return np.minimum(starts[:, None] + np.arange(3), count - 1)


FORMAT = Format(
    "lam", "LAM (.zip)", "Splats with ARKit shapes, for LAM's viewer in the browser", "avatar",
    (), read_lam, write_lam, shared_suffixes=(".zip",),
)  # fmt: skip
