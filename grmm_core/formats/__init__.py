"""Splat and mesh files of other programs, in and out.

============================  ==========================================================================================
`cloud`                       `SplatCloud`, what all splat readers return and writers take
`ply` `splat_file` `spz`      3DGS and GaussianAvatars PLY, .splat, SPZ
`sog` `glb` `gltf_splats`     SOG, the glTF container, KHR_gaussian_splatting
`mesh`                        .obj and .glb with morph targets
`avatars` `binding`           GaussianAvatars, CAP4D and LAM avatars; splats on triangles
`sequence`                    a file for every frame
`archive`                     zip archives that nobody vouches for
============================  ==========================================================================================

`read_splats`, `write_splats` and `write_mesh` choose by the file's extension and import only what they need. Called by the
command line and the Blender importers and exporters; knows nothing of Blender, torch or the model. Needs numpy only (SOG:
Pillow; SPZ 4: zstandard).

**Axes.** In memory y is up and faces look along +z, as in head space. Formats whose viewers take y as down (.ply, .splat, .sog)
are turned by half a turn about x on the way out and back on the way in, so that a head stands upright in other programs;
`axes="y_up"` keeps the numbers. Splats bound to triangles are never turned.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from .cloud import SplatCloud

SPLAT_EXTENSIONS = (".ply", ".splat", ".spz", ".sog", ".glb")
MESH_EXTENSIONS = (".obj", ".glb")

__all__ = ["MESH_EXTENSIONS", "SPLAT_EXTENSIONS", "SplatCloud", "read_splats", "write_mesh", "write_splats"]


def read_splats(path: str | os.PathLike[str], **options: Any) -> SplatCloud:
    """Read a splat file of any known format, chosen by its extension.

    Args:
        path: A .ply, .splat, .spz, .sog (or its meta.json), .glb or .gltf file.
        options: Passed to the reader: `axes` for .ply, .splat and .sog; `decode` for .sog.

    Returns:
        The splats, y up; `warnings` says what was dropped or assumed.

    Raises:
        FileFormatError: Unknown extension, another content than the extension says, or a damaged file.
        FileAccessError: Missing, a folder or unreadable.
        BackendError: The format needs a package that is not installed.
    """
    path = Path(path)
    extension = path.suffix.lower()
    if extension == ".ply":
        from .ply import read_ply as read
    elif extension == ".splat":
        from .splat_file import read_splat as read
    elif extension == ".spz":
        from .spz import read_spz as read
    elif extension == ".sog" or path.name.lower() == "meta.json":
        from .sog import read_sog as read
    elif extension in (".glb", ".gltf"):
        from .gltf_splats import read_gltf_splats as read
    else:
        raise FileFormatError(f"{path} has the extension {extension!r}; choose one of {', '.join(SPLAT_EXTENSIONS)}.")
    return read(path, **options)


def write_splats(path: str | os.PathLike[str], cloud: SplatCloud, **options: Any) -> None:
    """Write splats in the format that the extension names.

    Args:
        path: A .ply, .splat, .spz, .sog or .glb file.
        cloud: Splats, y up. Its color must be the one that looks right alone (the unrefined RGB).
        options: Passed to the writer: `axes` for .ply, .splat and .sog; `version`, `fractional_bits`, `full_sh` for .spz.

    Raises:
        FileFormatError: Unknown extension.
        ShapeError: The cloud is malformed.
        FileAccessError: The file cannot be written.
        BackendError: The format needs a package that is not installed.
    """
    extension = Path(path).suffix.lower()
    if extension == ".ply":
        from .ply import write_ply as write
    elif extension == ".splat":
        from .splat_file import write_splat as write
    elif extension == ".spz":
        from .spz import write_spz as write
    elif extension == ".sog":
        from .sog import write_sog as write
    elif extension == ".glb":
        from .gltf_splats import write_gltf_splats as write
    else:
        raise FileFormatError(f"Splats cannot be written as {extension!r}; choose one of {', '.join(SPLAT_EXTENSIONS)}.")
    write(path, cloud, **options)


def write_mesh(
    path: str | os.PathLike[str],
    vertices: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray | None = None,
    uv_faces: np.ndarray | None = None,
    morphs: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a triangle mesh in the format that the extension names.

    Args:
        path: A .obj or .glb file.
        vertices: [V, 3] metres, y up.
        faces: [F, 3] vertex indices.
        uv: [V, 2], or [U, 2] with `uv_faces`; v up.
        uv_faces: [F, 3] indices into `uv`.
        morphs: Name to movement [V, 3]; .glb only.

    Raises:
        FileFormatError: Unknown extension.
        ShapeError: The mesh is malformed.
        FileAccessError: The file cannot be written.
    """
    from .mesh import make_mesh, write_gltf_mesh, write_obj

    extension = Path(path).suffix.lower()
    if extension not in MESH_EXTENSIONS:
        raise FileFormatError(f"Meshes cannot be written as {extension!r}; choose one of {', '.join(MESH_EXTENSIONS)}.")
    mesh = make_mesh(vertices, faces, uv, uv_faces, morphs)
    if extension == ".obj":
        write_obj(path, mesh)
    else:
        write_gltf_mesh(path, mesh)
