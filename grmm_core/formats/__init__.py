"""Files of other programs, in and out: splats, meshes, avatars, performances.

==================  ==================================================================================================
`registry`          the one list of formats; `grmm_core.files.format` is the record that each module has
`splats`            `SplatCloud`; 3DGS PLY, .splat, SPZ, SOG, glTF with KHR_gaussian_splatting
`meshes`            `Mesh`; .obj, and .glb with morph targets
`avatars`           GaussianAvatars, CAP4D and LAM; splats on triangles; our avatars on the user's FLAME
`performances`      ARKit JSON, Live Link Face CSV, FLAME npz
`arrays`            everything as plain arrays
`sequence`          a file for every frame
`glb`               the glTF container
==================  ==================================================================================================

The functions here choose by the file's name and content and import only what they need. Called by the command line and the
Blender importers and exporters; knows nothing of Blender, torch or the model. Needs numpy only (SOG: Pillow; SPZ 4: zstandard).

**Axes.** In memory y is up and faces look along +z, as in head space. Formats whose viewers take y as down (.ply, .splat, .sog)
are turned by half a turn about x on the way out and back on the way in, so that a head stands upright in other programs;
`axes="y_up"` keeps the numbers. Splats bound to triangles are never turned.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ShapeError
from ..files.format import Format
from ..jobs.progress import Share
from ..performance.types import Performance
from .registry import format_to_read, format_to_write, formats, suffixes
from .splats.cloud import SplatCloud

if TYPE_CHECKING:
    from .avatars.cap4d import AnimatedAvatar
    from .avatars.gaussian_avatars import GaussianAvatar
    from .avatars.lam import LamAvatar

__all__ = [
    "Format",
    "SplatCloud",
    "format_to_read",
    "format_to_write",
    "formats",
    "read_avatar",
    "read_performance",
    "read_splats",
    "suffixes",
    "write_mesh",
    "write_performance",
    "write_splats",
]


def read_splats(path: str | os.PathLike[str], **options: Any) -> SplatCloud:
    """Read a splat file of any known format.

    Args:
        path: The file; a .sog may also be its meta.json.
        options: Passed to the reader: `axes` for .ply, .splat and .sog; `decode` for .sog.

    Returns:
        The splats, y up; `warnings` says what was dropped or assumed.

    Raises:
        FileFormatError: Unknown extension, another content than the extension says, or a damaged file.
        FileAccessError: Missing, a folder or unreadable.
        BackendError: The format needs a package that is not installed.
    """
    return format_to_read(Path(path), "splats").read(Path(path), **options)


def write_splats(path: str | os.PathLike[str], cloud: SplatCloud, **options: Any) -> tuple[str, ...]:
    """Write splats in the format that the extension names.

    Args:
        path: The file.
        cloud: Splats, y up. Its color must be the one that looks right alone (the unrefined RGB).
        options: Passed to the writer: `axes` for .ply, .splat and .sog; `version`, `fractional_bits`, `full_sh` for .spz.

    Returns:
        Sentences about what the format could not hold.

    Raises:
        FileFormatError: Unknown extension.
        ShapeError: The cloud is malformed.
        FileAccessError: The file cannot be written.
        BackendError: The format needs a package that is not installed.
    """
    return format_to_write(Path(path), "splats").write(Path(path), cloud, **options)


def read_avatar(
    path: str | os.PathLike[str], decode: Callable[[bytes], np.ndarray] | None = None
) -> GaussianAvatar | AnimatedAvatar | LamAvatar | SplatCloud:
    """Read an avatar of another project, or plain splats, by what is in the file.

    Args:
        path: A file of any format that holds splats, an avatar or a sequence; a folder for GaussianAvatars.
        decode: Decodes the pictures of a SOG file where Pillow is not installed (see `sog.read_sog`).

    Raises:
        FileFormatError, FileAccessError, BackendError: As the readers of the formats.
    """
    found = format_to_read(Path(path), ("splats", "avatar", "sequence"))
    return found.read(Path(path), **({"decode": decode} if found.name == "sog" else {}))


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
        path: The file.
        vertices: [V, 3] metres, y up.
        faces: [F, 3] vertex indices.
        uv: [V, 2], or [U, 2] with `uv_faces`; v up.
        uv_faces: [F, 3] indices into `uv`.
        morphs: Name to movement [V, 3]; formats without morph targets leave them out.

    Raises:
        FileFormatError: Unknown extension.
        ShapeError: The mesh is malformed.
        FileAccessError: The file cannot be written.
    """
    from .meshes.mesh import Mesh

    mesh = Mesh(vertices, faces, uv, uv_faces, dict(morphs or {})).validated()
    format_to_write(Path(path), "mesh").write(Path(path), mesh)


def read_performance(
    path: str | os.PathLike[str], *, fps: float | None = None, progress: Share | None = None, **options: Any
) -> Performance:
    """Read a recorded performance of any known format, chosen by what is in the file and not by its name alone.

    Args:
        path: The file.
        fps: Frame rate, over what the file states or implies.
        progress: Called with the fraction done; raise `CancelledError` from it to stop.
        options: Passed to the reader: what its `Format.reading` lists.

    Returns:
        The performance; `warnings` says what was missing, repaired or assumed.

    Raises:
        FileFormatError: The file is of no known format, or damaged.
        FileAccessError: Missing, a folder, unreadable or too large.
    """
    return format_to_read(Path(path), "performance").read(Path(path), fps=fps, progress=progress, **options)


def write_performance(path: str | os.PathLike[str], performance: Performance, progress: Share | None = None) -> None:
    """Write a performance in the format that the extension names.

    Args:
        path: The file.
        performance: ARKit weights, or expression coefficients for FLAME's .npz.
        progress: Called with the fraction done; raise `CancelledError` from it to stop before anything is written.

    Raises:
        FileFormatError: Unknown extension.
        ShapeError: The performance lacks what the format holds, or has values that are not finite.
        FileAccessError: The file cannot be written.
    """
    for name in ("times", *performance.channel_names()):
        if not np.isfinite(getattr(performance, name)).all():
            raise ShapeError(f"Performance.{name} has values that are not finite; remove these frames first.")
    format_to_write(Path(path), "performance").write(Path(path), performance, progress=progress)
    if progress:
        progress(1.0)
