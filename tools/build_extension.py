"""Validate and build the Blender extension: `python -m tools.build_extension [--output dist]`.

Uses Blender's own packaging tool out of the bpy wheel, in a process of its own; no Blender binary is needed. Called by
`make extension` and by the tests (`tests/blender_process.py`).
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
_TOOL = "scripts/addons_core/bl_pkg/cli/blender_ext.py"
_TAGS = "scripts/modules/_bpy_internal/extensions/tags.py"


class BuildError(Exception):
    """Blender's packaging tool is missing or refused the extension."""


def blender_resources() -> Path:
    """Return the versioned resource folder (such as `4.5/`) of the installed bpy wheel, without importing bpy."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        raise BuildError("bpy is not installed in this Python; install it with: pip install bpy")
    found = sorted(Path(spec.origin).parent.glob(f"*/{_TOOL}"))
    if not found:
        raise BuildError(f"The bpy wheel at {Path(spec.origin).parent} does not carry {_TOOL}.")
    return found[-1].parents[len(Path(_TOOL).parts) - 1]


def build(output: Path, source: Path = REPOSITORY) -> Path:
    """Validate `source` and pack it into `output`.

    Args:
        output: Folder for the zip; made when missing.
        source: Folder with `blender_manifest.toml`.

    Returns:
        The zip, named after the manifest's id and version.

    Raises:
        BuildError: Validation or packing failed; the message is the tool's.
    """
    resources = blender_resources()
    output.mkdir(parents=True, exist_ok=True)
    tags = ["--valid-tags", str(resources / _TAGS)]
    _run(resources, "validate", *tags, str(source))
    _run(resources, "build", "--source-dir", str(source), "--output-dir", str(output), *tags)
    manifest = tomllib.loads((source / "blender_manifest.toml").read_text("utf-8"))
    return output / f"{manifest['id']}-{manifest['version']}.zip"


def _run(resources: Path, *arguments: str) -> None:
    command = [sys.executable, str(resources / _TOOL), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode != 0:
        raise BuildError(f"{arguments[0]} failed: {(done.stdout + done.stderr).strip()}")


def main() -> int:
    """Build what the arguments ask for and print its paths; returns the exit code."""
    parser = argparse.ArgumentParser(description="Validate and build the Blender extension.")
    parser.add_argument("--output", type=Path, default=Path("dist"), help="folder for the zip (default: dist)")
    arguments = parser.parse_args()
    try:
        print(build(arguments.output.resolve()))
    except BuildError as error:
        print(f"build_extension: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
