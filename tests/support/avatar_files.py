"""Avatars of other projects that tests make: CAP4D's animated PLY, LAM's archive, the animation of a GaussianAvatars folder."""

from __future__ import annotations

import zipfile

import numpy as np
from mesh_files import grid
from splat_files import ply_bytes

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.formats.meshes.gltf_mesh import write_gltf_mesh
from grmm_core.formats.meshes.mesh import Mesh
from grmm_core.performance import Performance


def flame_track(count: int = 6) -> Performance:
    rng = np.random.default_rng(2)
    return Performance(
        np.arange(count) / 25,
        np.zeros((count, 52)),
        25.0,
        expression=rng.normal(0, 0.4, (count, 100)).astype(np.float32),
        head_rotation=rng.normal(0, 0.1, (count, 3)),
        neck_rotation=rng.normal(0, 0.1, (count, 3)),
        jaw_rotation=np.abs(rng.normal(0, 0.05, (count, 3))) * [1, 0, 0],
        left_eye_rotation=rng.normal(0, 0.1, (count, 3)),
        right_eye_rotation=rng.normal(0, 0.1, (count, 3)),
        shape=rng.normal(0, 0.5, 300).astype(np.float32),
        head_model="flame",
    )


def element(name, rows, binary=True):
    text = ply_bytes(rows).decode("latin1").split("end_header\n", 1)
    header = text[0].split("\n", 2)[2].replace("element vertex", f"element {name}")
    return header.encode("latin1"), text[1].encode("latin1")


def cap4d_bytes(quantised=True, frames=3):
    """An animated PLY: a sheet, splats on it, and offsets of every frame."""
    rng = np.random.default_rng(4)
    vertices, faces = grid()
    corner = np.zeros(len(faces), [(f"index_{k}", "<i4") for k in range(3)])
    for k in range(3):
        corner[f"index_{k}"] = faces[:, k]

    def xyz(values, code="<f4"):
        rows = np.zeros(len(values), [(axis, code) for axis in "xyz"])
        for k, axis in enumerate("xyz"):
            rows[axis] = values[:, k]
        return rows

    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
    splats = np.zeros(50, [(name, "<f4") for name in [*names, *(f"rot_{i}" for i in range(4)), "binding"]])
    for name in splats.dtype.names:
        splats[name] = rng.normal(size=50)
    splats["binding"] = rng.integers(0, len(faces), 50)
    parts = [element("faces", corner), element("base_vertex", xyz(vertices)), element("vertex", splats)]
    meshes = []
    for i in range(frames):
        offset = rng.normal(0, 0.01, vertices.shape).astype(np.float32)
        low, high = offset.min(0), offset.max(0)
        share = (offset - low) / (high - low)
        values = xyz((share * 255).astype(np.uint8), "u1") if quantised else xyz(share)
        parts += [element(f"meta_delta_min_{i:05d}", xyz(low[None])), element(f"meta_delta_max_{i:05d}", xyz(high[None]))]
        parts.append(element(f"delta_vertex_{i:05d}", values))
        meshes.append(vertices + offset)
    header = b"ply\nformat binary_little_endian 1.0\n" + b"".join(part[0] for part in parts) + b"end_header\n"
    return header + b"".join(part[1] for part in parts), meshes, faces


def lam_archive(path, change=None):
    """A LAM zip of a small sheet with the 51 morph targets."""
    vertices, faces = grid()
    rng = np.random.default_rng(5)
    morphs = {name: rng.normal(0, 0.01, vertices.shape) for name in ARKIT_NAMES if name != "tongueOut"}
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
    rows = np.zeros(len(vertices), [(name, "<f4") for name in [*names, *(f"rot_{i}" for i in range(4))]])
    for name in rows.dtype.names:
        rows[name] = rng.uniform(0.1, 0.9, len(rows)) * (0.01 if name in "xyz" else 1)
    write_gltf_mesh(path.with_suffix(".glb"), Mesh(vertices, faces, None, None, morphs))
    members = {"skin.glb": path.with_suffix(".glb").read_bytes(), "offset.ply": ply_bytes(rows), "vertex_order.json": b"[]"}
    members = change(members) if change else members
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(f"avatar/{name}", data)
    return vertices, morphs, rows
