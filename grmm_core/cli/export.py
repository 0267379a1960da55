"""`grmm export`: take an avatar, with an expression or a recorded performance, to other programs.

The name that is written says what: Gaussians, the mesh (with the ARKit shapes as morph targets where the format has
them; a .glb with --mesh), everything as arrays, LAM's avatar for the browser, or, for a name without an ending, a
GaussianAvatars folder. With --performance Gaussians and meshes become a file for each frame (#### in the name is where its
number goes), a GaussianAvatars folder gets the movement, and .csv, .json and .npz hold the performance itself. Exported
colors are those that look right alone, without the refinement network.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..controls.frame import Controls
from ..errors import ConfigError
from ..files.access import make_folder
from ..files.format import Format
from ..formats import format_to_write, formats
from ..formats.meshes.mesh import Mesh
from ..formats.registry import Kinds
from ..formats.sequence import frame_path
from ..head import HeadModel, load_open_head
from ..jobs.progress import Reporter, Share, nobody
from ..jobs.stages import EXPORT
from ..performance import Performance, to_arkit, to_expression
from ..performance.recording import record
from ..session import MAX_LOD, AvatarInfo, Session, create_session
from ..session.exporting import flame_avatar, lam_avatar, morph_targets, splat_cloud
from ..session.harmonics import DEFAULT_DEGREE, MAX_DEGREE
from .common import (
    add_avatar,
    add_controls,
    add_events,
    add_format_options,
    add_hair,
    add_model,
    add_output,
    check_folder,
    chooses_hair,
    controls_of,
    hair_of,
    options_of,
)
from .playing import add_playing, flame_of, performance_of, playable, together

_STILL: Kinds = ("splats", "mesh", "avatar", "arrays")
_PLAYED: Kinds = ("splats", "mesh", "avatar", "performance")
_PERFORMANCE_ONLY = (".csv", ".json")
_STILL_RATE = 25.0  # frames a second that a track of one frame states


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    known = [*formats(_STILL, written=True), *formats("performance", written=True)]
    parser = subparsers.add_parser(
        "export",
        help="write splats, meshes, avatars or performances for other programs",
        description=(__doc__ or "").partition("\n\n")[2],
        epilog="Formats: " + "; ".join(f"{one.label}: {one.description}" for one in known) + ".",
    )
    add_avatar(parser)
    names = dict.fromkeys(suffix for one in known for suffix in one.written_suffixes)
    add_output(parser, f"what to write: a file ({', '.join(names)}), or a folder for GaussianAvatars")
    add_controls(parser)
    add_hair(parser)
    parser.add_argument("--mesh", action="store_true", help="write the mesh with morph targets into a .glb")
    parser.add_argument(
        "--sh-degree", type=int, choices=range(MAX_DEGREE + 1), default=DEFAULT_DEGREE,
        help="view dependence of splat colors (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--lod", type=int, choices=range(MAX_LOD + 1), default=0, help="fewer, larger Gaussians (default: 0)")
    add_format_options(parser, known, "writing")
    playing = parser.add_argument_group("performances")
    add_playing(playing)
    add_model(parser)
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Evaluate the avatar and write the files."""
    path: Path = args.output
    if args.performance is None and path.suffix.lower() in _PERFORMANCE_ONLY:
        raise ConfigError(f"{path} would hold a performance; name one with --performance.")
    target = format_to_write(path, "mesh" if args.mesh else _PLAYED if args.performance else _STILL)
    _check_options(target, args)
    if not target.folder:
        check_folder(path)
    controls, played = controls_of(args), performance_of(args)
    if played is not None and target.name == "lam":
        raise ConfigError(f"{target.label} files hold no performance; leave --performance out, their viewer plays recordings.")
    with args.console.progress(EXPORT) as show:
        report = Reporter(EXPORT, show).part("write")
        if target.holds == "performance" and played is not None:
            content = _for_file(target, played, args)
            return _finish(
                args, [path], {"frames": played.frame_count}, (*content.warnings, *target.write(path, content, progress=report))
            )
        with create_session(weights=args.weights, device=args.device, threads=args.threads, head=args.head) as session:
            avatar = session.open(args.avatar)
            if target.folder:
                return _write_folder(target, session, avatar, controls, played, args)
            if played is not None:
                return _write_frames(target, session, avatar, controls, playable(played, avatar, args), args, report)
            content, counts = _content(target, session, avatar, controls, args, report)
            if target.holds == "splats":
                content = content.visible()  # files of a recording hold all, so that each has as many
                counts = {"gaussians": content.count}
    facts = {"avatar": avatar.name, **counts}
    return _finish(args, [path], facts, target.write(path, content, **options_of(args, target, "writing")))


def _check_options(target: Format, args: argparse.Namespace) -> None:
    """Refuse what the file could not hold. Raises `ConfigError`."""
    if target.holds == "mesh" and chooses_hair(args):
        raise ConfigError(f"{target.label} files hold no strands; leave the hair's options out, or write splats.")
    if target.holds == "performance" and (args.assignments or chooses_hair(args)):
        raise ConfigError(f"{args.output} holds the movement alone; leave --set and the hair's options out.")


def _finish(args: argparse.Namespace, files: list[Path], facts: dict[str, Any], warnings: tuple[str, ...]) -> dict[str, Any]:
    """Say what was written."""
    for sentence in warnings:
        args.console.message(sentence)
    counts = ", ".join(f"{value} {name}" for name, value in facts.items() if isinstance(value, int))
    args.console.line(f"Wrote {args.output if len(files) == 1 else f'{len(files)} files, {files[0]} first'} ({counts}).")
    size = sum(file.stat().st_size for file in files)
    return {"file": str(args.output), "files": list(map(str, files)), "bytes": size, **facts, "warnings": list(warnings)}


def _for_file(target: Format, played: Performance, args: argparse.Namespace) -> Performance:
    """A recording in the numbers that a performance file holds: FLAME's coefficients, or ARKit weights."""
    as_flame = target.name == "flame-npz"
    if as_flame == (played.expression is not None):
        return played
    what = f"{args.output} holds" if as_flame else f"{args.performance} has"
    flame = flame_of(args, f"{what} FLAME's coefficients and")
    return to_expression(played, flame) if as_flame else to_arkit(played, flame)


def _write_folder(
    target: Format, session: Session, avatar: AvatarInfo, controls: Controls, played: Performance | None,
    args: argparse.Namespace,
) -> dict[str, Any]:  # fmt: skip
    """Write a GaussianAvatars folder: the person at rest on the user's FLAME, moved by the recording or by --set."""
    flame = flame_of(args, f"{args.output} has no ending: it is a GaussianAvatars folder, which")
    if played is None:
        played = record([controls], np.zeros(1), _STILL_RATE, load_open_head())
    track = played if played.expression is not None else to_expression(played, flame)
    made = flame_avatar(session, avatar, controls.at_rest(), flame, track, args.sh_degree, args.lod, hair_of(args, avatar))
    make_folder(args.output)
    warnings = (*played.warnings, *target.write(args.output, made))
    facts = {"avatar": avatar.name, "gaussians": made.cloud.count, "frames": track.frame_count}
    return _finish(args, sorted(args.output.iterdir()), facts, warnings)


def _write_frames(
    target: Format, session: Session, avatar: AvatarInfo, controls: Controls, played: Performance,
    args: argparse.Namespace, report: Share,
) -> dict[str, Any]:  # fmt: skip
    """Write a file for each frame of a recording."""
    options, target = options_of(args, target, "writing"), replace(target, morphs=False)
    files, warnings = [], dict.fromkeys(played.warnings)
    for frame in range(played.frame_count):
        report(frame / played.frame_count)
        content, _ = _content(target, session, avatar, together(controls, played.controls(frame)), args)
        files.append(frame_path(args.output, frame))
        warnings |= dict.fromkeys(target.write(files[-1], content, **options))
    return _finish(args, files, {"avatar": avatar.name, "frames": len(files)}, tuple(warnings))


def _content(
    target: Format, session: Session, avatar: AvatarInfo, controls: Controls, args: argparse.Namespace,
    report: Share = nobody,
) -> tuple[Any, dict[str, int]]:  # fmt: skip
    """What is written, and how much of it there is; `report` hears of expressions that are evaluated one by one."""
    if target.name == "lam":
        made = lam_avatar(session, avatar, controls, args.lod, report, hair_of(args, avatar))
        return made, {"gaussians": made.cloud.count, "morphs": len(made.mesh.morphs)}
    if target.holds == "splats":
        cloud = splat_cloud(session, avatar, controls, args.sh_degree, args.lod, hair_of(args, avatar))
        return cloud, {"gaussians": cloud.count}
    head = _head(avatar)
    mesh = session.deform(avatar.id, controls)
    if target.holds == "mesh":
        morphs = morph_targets(session, avatar.id, controls, report=report) if target.morphs else {}
        count = {"vertices": len(mesh.vertices), "faces": len(head.faces), **({"morphs": len(morphs)} if morphs else {})}
        return Mesh(mesh.vertices, head.faces, head.uv, head.uv_faces, morphs), count
    cloud = splat_cloud(session, avatar, controls, args.sh_degree, args.lod, hair_of(args, avatar))
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
