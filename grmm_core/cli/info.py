"""`grmm info`: what is installed here, or what is in a file."""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import os
import platform
from pathlib import Path
from typing import Any

from .. import __version__
from ..avatar import EXTENSION, AvatarHeader, load_avatar, read_avatar_header
from ..avatar.library import DEFAULT_NAME, LIBRARY_PREFIX, library_file, library_names, library_path
from ..errors import ConfigError, FileAccessError, GrmmError
from ..files.npz import read_npz
from ..files.tensorfile import read_metadata
from ..formats import Format, format_to_read, formats, suffixes
from ..formats.performances.flame_npz import is_track
from ..head import FLAME_SUFFIXES
from ..head.flame import describe_flame
from ..head.flame_file import is_flame_npz
from ..session.sources import SAMPLE_PREFIX
from .common import add_format_options, options_of

LIBRARIES = ("numpy", "torch", "numba", "onnxruntime", "pillow", "bpy", "gsplat")
ASSETS = Path(__file__).resolve().parent.parent / "assets"
HASH_DIGITS = 12


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "info", help="what is installed, or what is in a file", description="Show what is installed, or what is in a file."
    )
    parser.add_argument(
        "avatar", metavar="AVATAR", nargs="?", type=Path, help="any file that is read here, default, or library:NAME"
    )
    add_format_options(parser, formats("performance", read=True), "reading")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Show the facts and return them."""
    facts = installation() if args.avatar is None else describe_file(_file_of(args.avatar), args)
    _show(args.console, facts)
    return facts


def _file_of(given: Path) -> Path:
    """The file that an argument names; a file called "default" is meant where there is one."""
    if str(given) == DEFAULT_NAME and not given.exists():
        return library_path(DEFAULT_NAME)
    if given.name.startswith(SAMPLE_PREFIX) and not given.exists():
        raise ConfigError(f"{given} is a person without a file; write one with grmm sample.")
    found = library_file(str(given)) or given
    if not found.exists():
        raise FileAccessError(f"{given} does not exist; check the file name, or see the library's with grmm info.")
    return found


def installation() -> dict[str, Any]:
    """Return versions, devices, rasteriser backends, head models and weights."""
    facts: dict[str, Any] = {
        "grmm": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "libraries": {name: _version(name) for name in LIBRARIES},
    }
    if importlib.util.find_spec("torch") is not None:
        import torch

        devices = ["cpu"] + [f"cuda ({torch.cuda.get_device_name(i)})" for i in range(torch.cuda.device_count())]
        facts["devices"] = devices + (["mps"] if torch.backends.mps.is_available() else [])
    else:
        facts["devices"] = []
    from ..splat import available_backends

    facts["rasterisers"] = {b.name: ("" if b.available else "not available: ") + b.detail for b in available_backends()}
    facts["head models"] = [describe_asset(path) for path in sorted(ASSETS.glob("*head*.safetensors"))]
    facts["avatars"] = [f"{LIBRARY_PREFIX}{name}" for name in library_names()]
    facts["formats"] = {one.label: _ways(one) for one in formats()}
    facts["weights"] = [describe_asset(path) for path in sorted((ASSETS / "weights").glob("*.safetensors"))]
    return facts


def describe_file(path: Path, options: argparse.Namespace | None = None) -> dict[str, Any]:
    """Return what is in a file that is read here.

    Args:
        path: The file.
        options: Options of performance formats, by their names.

    Raises:
        FileAccessError, FileFormatError: It cannot be read.
        ConfigError: It is of another kind.
    """
    if path.suffix == ".safetensors":
        return describe_asset(path, strict=True)
    if path.suffix.lower() in FLAME_SUFFIXES and not is_track(path):
        return describe_flame(path) if path.suffix.lower() != ".npz" or is_flame_npz(path) else _describe_arrays(path)
    if path.suffix != EXTENSION:
        return _describe_foreign(path, options)
    header = read_avatar_header(path)
    avatar = load_avatar(path)
    return _header_facts(path, header) | {
        "z_id": avatar.z_id.size,
        "z_exp": avatar.z_exp.size,
        "changed parameters": sorted(avatar.deltas),
        "painted": bool(avatar.painting.size),
        "tracking": sorted(avatar.tracking),
        "photos": [{"name": photo.name, "sha256": photo.sha256} for photo in header.provenance.photos],
    }


def _describe_foreign(path: Path, options: argparse.Namespace | None) -> dict[str, Any]:
    """Read a file of another program and say what it holds."""
    known = formats(read=True)
    if not path.is_dir() and not any(one.fits(path) for one in known):
        raise ConfigError(
            f"{path} is neither an avatar ({EXTENSION}), weights (.safetensors), a FLAME model ({', '.join(FLAME_SUFFIXES)}) "
            f"nor of another format that is read ({', '.join(suffixes(known))}); give one of these."
        )
    found = format_to_read(path)
    content = found.read(path, **(options_of(options, found, "reading") if options and found.holds == "performance" else {}))
    warnings = getattr(content, "warnings", None) or getattr(getattr(content, "cloud", None), "warnings", [])
    return {"file": str(path), "kind": found.label, **content.summary(), "warnings": warnings}


def _describe_arrays(path: Path) -> dict[str, Any]:
    """Name the arrays of an .npz, such as `grmm export` and `grmm render` write."""
    arrays, _ = read_npz(path)
    shapes = {name: f"{array.dtype} [{', '.join(map(str, array.shape))}]" for name, array in arrays.items()}
    return {"file": str(path), "kind": "arrays", "arrays": shapes}


def describe_asset(path: Path, strict: bool = False) -> dict[str, Any]:
    """Return what a weights or head file says about itself; without `strict` an unreadable one is described by its error."""
    try:
        metadata = read_metadata(path)
        facts: dict[str, Any] = {"file": str(path), "bytes": path.stat().st_size}
        if "grmm" not in metadata:
            return facts | {"kind": metadata.get("format", "unknown"), "name": metadata.get("name", path.stem)}
        if importlib.util.find_spec("torch") is None:
            return facts | {"kind": "grmm-weights", "name": path.stem}
        from ..model.weights_file import read_info

        info = read_info(path)
        return facts | {
            "kind": "grmm-weights",
            "name": info.name,
            "configuration": info.config.name,
            "grid": info.config.grid,
            "people": len(info.people),
            "head": info.head_name,
            "provenance": dict(info.provenance),
        }
    except GrmmError as error:
        if strict:
            raise
        return {"file": str(path), "error": str(error)}


def _header_facts(path: Path, header: AvatarHeader) -> dict[str, Any]:
    return {
        "file": str(path),
        "kind": "grmm-avatar",
        "format version": header.format_version,
        "name": header.name,
        "head": f"{header.head.name} ({header.head.sha256[:HASH_DIGITS]})",
        "weights": f"{header.weights.name} ({header.weights.sha256[:HASH_DIGITS]})",
        "made by": header.provenance.made_by,
        "date": header.provenance.date,
        "from photos": header.provenance.from_photos,
        "licence": header.provenance.licence,
        "thumbnail bytes": len(header.thumbnail),
    }


def _ways(entry: Format) -> str:
    """Whether a format is read and written here, and which packages something about it lacks."""
    ways = [way for way, able in (("read", entry.reader), ("written", entry.writer)) if able is not None]
    lacking = [f"{what} needs {name}" for name, what in entry.needs.items() if importlib.util.find_spec(name) is None]
    return "; ".join([" and ".join(ways), *lacking])


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _show(console: Any, facts: dict[str, Any], indent: str = "") -> None:
    for name, value in facts.items():
        if isinstance(value, dict):
            console.line(f"{indent}{name}:")
            _show(console, value, indent + "  ")
        elif isinstance(value, list):
            console.line(f"{indent}{name}:" + ("" if value else " none"))
            for item in value:
                if isinstance(item, dict):
                    label = item.get("name", item.get("file", ""))
                    rest = ", ".join(f"{k} {v}" for k, v in item.items() if k != "name" and not isinstance(v, dict))
                    console.line(f"{indent}  {label} ({rest})")
                else:
                    console.line(f"{indent}  {item}")
        else:
            console.line(f"{indent}{name}: {_text(value)}")


def _text(value: Any) -> str:
    if value is None:
        return "not installed"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)
