"""Build every zip of a release: `python -m tools.release [--output dist] [--wheels build/wheels] [--only linux-x64-py313]`.

Stock Blender has numpy and nothing else that the model needs. A zip for a platform and a Python carries the wheels of the
runtime without torch (`RUNTIME`), which Blender unpacks beside the extension; one zip without wheels is for sites with limits
and for other platforms. Wheels belong to one Python: 3.11 of Blender 4.5 and 5.0, 3.13 of Blender 5.1 and later, 3.14 of
distributions that build Blender with their own. They come from the Python package index by pip, once, into `--wheels`.
Every zip is validated by Blender's own tool.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from .build_extension import REPOSITORY, BuildError, build

RUNTIME = ("numba==0.68.1", "llvmlite==0.50.0", "onnxruntime==1.31.1")
MAX_BYTES = 200_000_000
PLATFORM_TAGS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64", "manylinux_2_17_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64", "macosx_13_0_arm64", "macosx_12_0_arm64", "macosx_11_0_arm64"),
}
PYTHON_VERSIONS = ("3.11", "3.13", "3.14")
SLIM = "slim"


@dataclass(frozen=True)
class Target:
    """One zip with wheels: Blender's name of the platform, and the version of its Python."""

    platform: str
    python: str

    @property
    def name(self) -> str:
        """Part of the zip's name, such as "linux-x64-py313"."""
        return f"{self.platform}-py{self.python.replace('.', '')}"


TARGETS = tuple(Target(platform, python) for platform in PLATFORM_TAGS for python in PYTHON_VERSIONS)


def fetch_wheels(target: Target, folder: Path) -> list[Path]:
    """Return the wheels of a target, downloaded where the folder does not hold them yet. Raises `BuildError`."""
    own = folder / target.name
    wheels = sorted(own.glob("*.whl"))
    if {_pin(path) for path in wheels} == set(RUNTIME):
        return wheels
    shutil.rmtree(own, ignore_errors=True)
    own.mkdir(parents=True)
    tags = [part for tag in PLATFORM_TAGS[target.platform] for part in ("--platform", tag)]
    version = target.python.replace(".", "")
    command = [
        sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps",
        "--only-binary=:all:", "--implementation", "cp", "--python-version", version, "--abi", f"cp{version}", *tags,
        "--dest", str(own), *RUNTIME,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)
    wheels = sorted(own.glob("*.whl"))
    if done.returncode != 0 or len(wheels) != len(RUNTIME):
        raise BuildError(f"The wheels of {target.name} could not be downloaded: {done.stderr.strip()[-500:]}")
    return wheels


def build_zip(target: Target | None, wheels: list[Path], output: Path) -> Path:
    """Build and validate the zip of a target, or the slim one where it is None; returns its path. Raises `BuildError`."""
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "source"
        _copy_tracked_files(source)
        if target is not None:
            (source / "wheels").mkdir()
            for wheel in wheels:
                shutil.copy(wheel, source / "wheels" / wheel.name)
            manifest = source / "blender_manifest.toml"
            manifest.write_text(_with_wheels(manifest.read_text("utf-8"), target, wheels), "utf-8")
        made = build(Path(temporary) / "out", source)
        output.mkdir(parents=True, exist_ok=True)
        final = output / f"{made.stem}-{SLIM if target is None else target.name}.zip"
        shutil.move(made, final)
    if final.stat().st_size > MAX_BYTES:
        raise BuildError(f"{final} has {final.stat().st_size / 1e6:.0f} MB; {MAX_BYTES / 1e6:.0f} are allowed.")
    return final


def _with_wheels(manifest: str, target: Target, wheels: list[Path]) -> str:
    """The manifest with what makes it one platform's: lines before its first table."""
    names = "".join(f'  "./wheels/{wheel.name}",\n' for wheel in wheels)
    lines = f'platforms = ["{target.platform}"]\nwheels = [\n{names}]\n\n'
    table = manifest.index("\n[") + 1
    return manifest[:table] + lines + manifest[table:]


def _copy_tracked_files(target: Path) -> None:
    """Copy what belongs to the project: a release must not hold what lies beside it by chance."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=True, timeout=60)
    for name in filter(None, listed.stdout.split("\0")):
        place = target / name
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPOSITORY / name, place)


def _pin(wheel: Path) -> str:
    name, version = wheel.name.split("-")[:2]
    return f"{name}=={version}"


def main() -> int:
    """Build what the arguments ask for and print its paths; returns the exit code."""
    parser = argparse.ArgumentParser(description="Build and validate every zip of a release.")
    parser.add_argument("--output", type=Path, default=Path("dist"), help="folder for the zips (default: dist)")
    parser.add_argument("--wheels", type=Path, default=Path("build/wheels"), help="kept downloads (default: build/wheels)")
    parser.add_argument("--only", choices=[SLIM, *(target.name for target in TARGETS)], help="one zip")
    arguments = parser.parse_args()
    try:
        for target in (None, *TARGETS):
            if arguments.only in (None, SLIM if target is None else target.name):
                wheels = [] if target is None else fetch_wheels(target, arguments.wheels)
                made = build_zip(target, wheels, arguments.output.resolve())
                print(f"{made}  {made.stat().st_size / 1e6:.0f} MB", flush=True)
    except BuildError as error:
        print(f"release: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
