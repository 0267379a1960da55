"""Wavefront `.obj` files: vertices, texture coordinates, triangles. Needs numpy only."""

from __future__ import annotations

import io
import os

import numpy as np

from ...files.access import atomic_write_bytes
from ...files.format import Format
from .mesh import Mesh


def write_obj(path: str | os.PathLike[str], mesh: Mesh) -> None:
    """Write a Wavefront file: vertices, texture coordinates, triangles. Morph targets do not fit this format and are left out.

    Raises:
        ShapeError: The mesh is malformed.
        FileAccessError: The file cannot be written.
    """
    mesh = mesh.validated()
    text = io.StringIO()
    text.write("# metres, y up, face towards +z\n")
    np.savetxt(text, mesh.vertices, "v %.7g %.7g %.7g")
    if mesh.uv is not None:
        np.savetxt(text, mesh.uv, "vt %.7g %.7g")
    if mesh.faces is not None:
        corners = mesh.faces + 1
        if mesh.uv is None:
            np.savetxt(text, corners, "f %d %d %d")
        else:
            uv = corners if mesh.uv_faces is None else mesh.uv_faces + 1
            np.savetxt(text, np.stack([corners, uv], -1).reshape(-1, 6), "f %d/%d %d/%d %d/%d")
    atomic_write_bytes(path, text.getvalue().encode("ascii"))


FORMAT = Format("obj", "Wavefront (.obj)", "The mesh alone, without morph targets", "mesh", (".obj",), writer=write_obj)
