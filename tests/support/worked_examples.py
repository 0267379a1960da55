"""Carry out the chapters of `docs/extending.md`: their fenced blocks change a copy of the packages and run in it.

========================  =========================================================================================
```` ```diff ````         changes one file: `+++ path`, then context, `-` and `+` lines, hunks set apart by `@@`; a file
                          that is new has `+` lines only. What is taken away must be in the file, once
```` ```python ````       runs in the copy, as a file of its own
```` ```python ````       with `import bpy` as its first line: in Blender, with the changed extension installed
```` ```console ````      `$ grmm ...` runs in the copy; lines below it are looked for in what it prints
any other language        is for the reader
========================  =========================================================================================

A chapter is a heading of the second level. Each gets a copy of its own.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "extending.md"
PACKAGES = ("grmm_core", "grmm_blender", "operators")
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_TIMEOUT = 300.0  # seconds; kernels may compile


@dataclass(frozen=True)
class Chapter:
    """A chapter: its heading, and language and text of each fenced block in order."""

    title: str
    blocks: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        return self.title

    @property
    def files(self) -> list[str]:
        """Files that its diffs change or make, each once."""
        return list(dict.fromkeys(_parse(text)[0] for language, text in self.blocks if language == "diff"))

    @property
    def blender_blocks(self) -> list[str]:
        return [text for language, text in self.blocks if language == "python" and _is_for_blender(text)]


def chapters(document: Path = DOCUMENT) -> list[Chapter]:
    """The chapters with something to carry out."""
    parts = re.split(r"^## +(.+)$", document.read_text("utf-8"), flags=re.MULTILINE)
    found = [Chapter(title, tuple(_BLOCK.findall(body))) for title, body in zip(parts[1::2], parts[2::2], strict=True)]
    return [chapter for chapter in found if chapter.blocks]


def copy_packages(folder: Path) -> Path:
    """Copy the packages without their assets, which are linked; compiled kernels come along."""
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("assets"))
    (folder / "grmm_core" / "assets").symlink_to(ROOT / "grmm_core" / "assets")
    return folder


def apply_diffs(chapter: Chapter, folder: Path) -> None:
    """Make the changes of a chapter's diffs in the packages of a folder."""
    for language, text in chapter.blocks:
        if language == "diff":
            apply_diff(text, folder)


def apply_diff(text: str, folder: Path) -> None:
    """Carry out one diff block; a change that does not fit its file is an AssertionError."""
    name, hunks = _parse(text)
    path = folder / name
    if not path.exists():
        lines = text.splitlines()[1:]
        assert all(line.startswith("+") for line in lines), f"{name} does not exist, and the diff does not make it whole"
        path.write_text("".join(f"{line[1:]}\n" for line in lines), "utf-8")
        return
    content = path.read_text("utf-8")
    for old, new in hunks:
        assert content.count(old) == 1, f"{name} has these lines {content.count(old)} times:\n{old}"
        content = content.replace(old, new)
    path.write_text(content, "utf-8")


def run_outside_blender(chapter: Chapter, folder: Path) -> None:
    """Run a chapter's python and console blocks in a folder whose packages have its changes."""
    for number, (language, text) in enumerate(chapter.blocks):
        if language == "python" and not _is_for_blender(text):
            script = folder / f"block_{number}.py"
            script.write_text(text, "utf-8")
            _run([sys.executable, str(script)], folder, text)
        elif language == "console":
            for command, expected in _commands(text):
                printed = _run([sys.executable, "-m", "grmm_core", *shlex.split(command)], folder, command)
                missing = [line for line in expected if " ".join(line.split()) not in " ".join(printed.split())]
                assert not missing, f"grmm {command} did not print {missing}, but:\n{printed}"


def _parse(diff: str) -> tuple[str, list[tuple[str, str]]]:
    """File of a diff, and the lines before and after of each of its hunks."""
    header, _, body = diff.partition("\n")
    assert header.startswith("+++ "), f"a diff begins with '+++ path', not with {header!r}"
    hunks = []
    for hunk in re.split(r"^@@.*\n", body, flags=re.MULTILINE):
        lines = [line or " " for line in hunk.splitlines()]
        wrong = [line for line in lines if line[0] not in " +-"]
        assert not wrong, f"not a line of a diff: {wrong}"
        if lines:
            old, new = ("".join(f"{line[1:]}\n" for line in lines if line[0] in kept) for kept in (" -", " +"))
            hunks.append((old, new))
    return header.removeprefix("+++ ").strip(), hunks


def _is_for_blender(text: str) -> bool:
    return text.startswith("import bpy\n")


def _commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Arguments of each `$ grmm` of a console block, with the lines below it."""
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        command, *expected = [line for line in part.splitlines() if line.strip()]
        assert command.startswith("grmm "), f"only grmm can be run, not {command!r}"
        yield command.removeprefix("grmm "), expected


def _run(command: list[str], folder: Path, what: str) -> str:
    variables = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(
        command, cwd=folder, env=variables, capture_output=True, text=True, timeout=_TIMEOUT, check=False
    )  # fmt: skip
    assert done.returncode == 0, f"{what}\nended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr
