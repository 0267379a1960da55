"""`grmm export`: take an avatar, with an expression, to other programs.

By the ending of the file: .ply, .splat, .spz and .glb hold Gaussians (.glb with --mesh: the mesh with the aligned
expressions as morph targets), .obj the mesh, .npz everything as arrays. Exported colors are those that look right alone,
without the refinement network.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import Any

import numpy as np

from ..controls.frame import Controls
from ..controls.names import ALIGNED_NAMES
from ..errors import ConfigError
from ..files.access import atomic_write_bytes
from ..formats import write_mesh, write_splats
from ..head import HeadModel, load_open_head
from ..session import MAX_LOD, AvatarInfo, Session, create_session
from ..session.exporting import morph_targets, splat_cloud
from ..session.harmonics import MAX_DEGREE
from .common import add_avatar, add_controls, add_model, add_output, check_folder, controls_of

SUFFIXES = (".ply", ".spz", ".splat", ".glb", ".obj", ".npz")


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "export",
        help="write splats or a mesh for other programs",
        description=(__doc__ or "").partition("\n\n")[2],
    )
    add_avatar(parser)
    add_output(parser, f"the file to write: {', '.join(SUFFIXES)}")
    add_controls(parser)
    parser.add_argument("--mesh", action="store_true", help="write the mesh with morph targets into a .glb")
    parser.add_argument(
        "--sh-degree", type=int, choices=range(MAX_DEGREE + 1), default=1, help="view dependence of splat colors (default: 1)"
    )
    parser.add_argument("--lod", type=int, choices=range(MAX_LOD + 1), default=0, help="fewer, larger Gaussians (default: 0)")
    add_model(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Evaluate the avatar and write the file."""
    path: Path = args.output
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ConfigError(f"{path} does not end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}; choose one of these formats.")
    if args.mesh and suffix not in (".glb", ".obj"):
        raise ConfigError(f"A mesh cannot be written as {suffix}; use .glb or .obj.")
    check_folder(path)
    controls = controls_of(args)
    with create_session(weights=args.weights, device=args.device, threads=args.threads, head=args.head) as session:
        avatar = session.open(args.avatar)
        if suffix == ".npz":
            count = _write_arrays(path, session, avatar, controls, args)
        elif suffix == ".obj" or args.mesh:
            count = _write_mesh(path, session, avatar, controls, args)
        else:
            cloud = splat_cloud(session, avatar.id, controls, args.sh_degree, args.lod)
            write_splats(path, cloud)
            count = {"gaussians": cloud.count}
    args.console.line(f"Wrote {path} ({', '.join(f'{value} {name}' for name, value in count.items())}).")
    return {"file": str(path), "avatar": avatar.name, "bytes": path.stat().st_size, **count}


def _write_mesh(
    path: Path, session: Session, avatar: AvatarInfo, controls: Controls, args: argparse.Namespace
) -> dict[str, int]:
    head = _head(avatar)
    vertices = session.deform(avatar.id, controls).vertices
    morphs: dict[str, np.ndarray] = {}
    if path.suffix.lower() == ".glb":
        with args.console.progress("expressions", len(ALIGNED_NAMES)) as bar:
            morphs = morph_targets(session, avatar.id, controls, report=lambda name: bar.advance(note=name))
    write_mesh(path, vertices, head.faces, head.uv, head.uv_faces, morphs or None)
    return {"vertices": len(vertices), "faces": len(head.faces), **({"morphs": len(morphs)} if morphs else {})}


def _write_arrays(
    path: Path, session: Session, avatar: AvatarInfo, controls: Controls, args: argparse.Namespace
) -> dict[str, int]:
    head = _head(avatar)
    mesh = session.deform(avatar.id, controls)
    cloud = splat_cloud(session, avatar.id, controls, args.sh_degree, args.lod)
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        vertices=mesh.vertices, displacement=mesh.displacement, joints=mesh.joints,
        faces=head.faces, uv=head.uv, uv_faces=head.uv_faces,
        means=cloud.means, quats=cloud.quats, scales=cloud.scales, opacities=cloud.opacities, sh=cloud.sh,
        z_id=avatar.z_id, shape=avatar.shape, aligned=controls.aligned, pose=controls.pose,
    )  # fmt: skip
    atomic_write_bytes(path, stream.getvalue())
    return {"vertices": len(mesh.vertices), "gaussians": cloud.count}


def _head(avatar: AvatarInfo) -> HeadModel:
    head = load_open_head()
    if head.name != avatar.head_name:
        raise ConfigError(f"The avatar is on the head model {avatar.head_name!r}, whose mesh is not installed; export splats.")
    return head
