"""`grmm export`: take an avatar, with an expression, to other programs.

The ending of the file says what is written: Gaussians, the mesh (with the ARKit shapes as morph targets where the format has
them; a .glb with --mesh), or everything as arrays. Exported colors are those that look right alone, without the refinement
network.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from ..controls.frame import Controls
from ..errors import ConfigError
from ..files.format import Format
from ..formats import format_to_write, formats, suffixes
from ..formats.meshes.mesh import Mesh
from ..head import HeadModel, load_open_head
from ..jobs.progress import Reporter
from ..jobs.stages import EXPORT
from ..session import MAX_LOD, AvatarInfo, Session, create_session
from ..session.exporting import morph_targets, splat_cloud
from ..session.harmonics import DEFAULT_DEGREE, MAX_DEGREE
from .common import (
    add_avatar,
    add_controls,
    add_events,
    add_format_options,
    add_model,
    add_output,
    check_folder,
    controls_of,
    options_of,
)

_WRITTEN: tuple[Any, ...] = ("splats", "mesh", "arrays")


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    known = formats(_WRITTEN, written=True)
    parser = subparsers.add_parser(
        "export",
        help="write splats or a mesh for other programs",
        description=(__doc__ or "").partition("\n\n")[2],
        epilog="Formats: " + "; ".join(f"{one.label}: {one.description}" for one in known) + ".",
    )
    add_avatar(parser)
    add_output(parser, f"the file to write: {', '.join(suffixes(known, shared=False))}")
    add_controls(parser)
    parser.add_argument("--mesh", action="store_true", help="write the mesh with morph targets into a .glb")
    parser.add_argument(
        "--sh-degree", type=int, choices=range(MAX_DEGREE + 1), default=DEFAULT_DEGREE,
        help="view dependence of splat colors (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--lod", type=int, choices=range(MAX_LOD + 1), default=0, help="fewer, larger Gaussians (default: 0)")
    add_format_options(parser, known, "writing")
    add_model(parser)
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Evaluate the avatar and write the file."""
    path: Path = args.output
    target = format_to_write(path, "mesh" if args.mesh else _WRITTEN)
    check_folder(path)
    controls = controls_of(args)
    with create_session(weights=args.weights, device=args.device, threads=args.threads, head=args.head) as session:
        avatar = session.open(args.avatar)
        content, count = _content(target, session, avatar, controls, args)
    warnings = target.write(path, content, **options_of(args, target, "writing"))
    for sentence in warnings:
        args.console.message(sentence)
    args.console.line(f"Wrote {path} ({', '.join(f'{value} {name}' for name, value in count.items())}).")
    return {"file": str(path), "avatar": avatar.name, "bytes": path.stat().st_size, **count, "warnings": list(warnings)}


def _content(
    target: Format, session: Session, avatar: AvatarInfo, controls: Controls, args: argparse.Namespace
) -> tuple[Any, dict[str, int]]:
    """What is written, and how much of it there is."""
    if target.holds == "splats":
        cloud = splat_cloud(session, avatar.id, controls, args.sh_degree, args.lod)
        return cloud, {"gaussians": cloud.count}
    head = _head(avatar)
    mesh = session.deform(avatar.id, controls)
    if target.holds == "mesh":
        morphs: dict[str, np.ndarray] = {}
        if target.morphs:
            with args.console.progress(EXPORT) as show:
                morphs = morph_targets(session, avatar.id, controls, report=Reporter(EXPORT, show).part("write"))
        count = {"vertices": len(mesh.vertices), "faces": len(head.faces), **({"morphs": len(morphs)} if morphs else {})}
        return Mesh(mesh.vertices, head.faces, head.uv, head.uv_faces, morphs), count
    cloud = splat_cloud(session, avatar.id, controls, args.sh_degree, args.lod)
    arrays = {
        "vertices": mesh.vertices, "displacement": mesh.displacement, "joints": mesh.joints,
        "faces": head.faces, "uv": head.uv, "uv_faces": head.uv_faces,
        "means": cloud.means, "quats": cloud.quats, "scales": cloud.scales, "opacities": cloud.opacities, "sh": cloud.sh,
        "z_id": avatar.z_id, "shape": avatar.shape, "aligned": controls.aligned, "pose": controls.pose,
    }  # fmt: skip
    return arrays, {"vertices": len(mesh.vertices), "gaussians": cloud.count}


def _head(avatar: AvatarInfo) -> HeadModel:
    head = load_open_head()
    if head.name != avatar.head_name:
        raise ConfigError(f"The avatar is on the head model {avatar.head_name!r}, whose mesh is not installed; export splats.")
    return head
