"""Compiled kernels that outlive a test run: each Blender of the tests begins with a new install, in which none is compiled.

Compiling them takes longer than most tests, so an install borrows what earlier ones compiled, and what it adds is kept.
Numba accepts a compiled form when its source has the same time and size, and does not look at what the source imports.
So the store of a module with kernels is named after its contents and those of all modules of the core that it reaches by
imports: constants are compiled in, functions are inlined. Numba itself refuses forms of another version of itself or processor.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import os
import re
import shutil
import tempfile
from pathlib import Path

STORE = Path(__file__).resolve().parent.parent / "build" / "test-kernels"
KERNEL_TIME = 1_700_000_000  # seconds; any constant
HAS_KERNELS = re.compile(r"^from \.[\w.]*(compute\.kernels|jit) import ", re.MULTILINE)
CACHE = "__pycache__"
_found: list[tuple[Path, Path]] = []  # relative source, store


def lend_kernels(core: Path) -> None:
    """Lend the core of an install, as it was packed, its compiled kernels; once more, what others have compiled since."""
    for source, store in _stores(core):
        os.utime(source, (KERNEL_TIME, KERNEL_TIME))
        cache = source.parent / CACHE
        with contextlib.suppress(FileNotFoundError, shutil.Error):  # another process of the run puts a larger one in its place
            if any(not (cache / path.name).exists() for path in store.iterdir()):
                shutil.copytree(store, cache, dirs_exist_ok=True)


def keep_kernels(core: Path) -> None:
    """Keep what was compiled for a core that `lend_kernels` has seen, or for a copy of it."""
    for source, store in _stores(core):
        compiled = list((source.parent / CACHE).glob(f"{source.stem}.*.nb?"))
        if all((store / path.name).exists() for path in compiled):
            continue
        STORE.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix="new-", dir=STORE))
        for path in compiled:
            shutil.copy2(path, made)
        # As a whole: an index is right only with the files that it was written with.
        with contextlib.suppress(OSError):  # another process of the run was quicker
            if store.exists():
                store.rename(made / "before")
            made.rename(store)
            made = store / "before"
        shutil.rmtree(made, ignore_errors=True)


def _stores(core: Path) -> list[tuple[Path, Path]]:
    """Modules with kernels in a core, and the store of each. All installs of a test run have the same modules."""
    if not _found:
        for source in sorted(core.rglob("*.py")):
            if HAS_KERNELS.search(source.read_text("utf-8")):
                digest = hashlib.sha256()
                for path in sorted(_reached(source)):
                    digest.update(path.relative_to(core).as_posix().encode() + b"\0" + path.read_bytes())
                _found.append((source.relative_to(core), STORE / f"{source.stem}-{digest.hexdigest()[:16]}"))
    return [(core / name, store) for name, store in _found]


def _reached(source: Path) -> set[Path]:
    """The module and all that it imports by relative imports, directly or not."""
    found, left = {source}, [source]
    while left:
        new = _imports(left.pop()) - found
        found |= new
        left += new
    return found


@functools.cache
def _imports(source: Path) -> frozenset[Path]:
    """Modules that one takes names from by relative imports."""
    found = set()
    for node in ast.walk(ast.parse(source.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = source.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            names = [base, *(base / name.name for name in node.names)]
            found |= {path for name in names for path in (name.with_suffix(".py"), name / "__init__.py") if path.exists()}
    return frozenset(found)
