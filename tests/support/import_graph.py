"""Who imports whom in the product, read from the sources without running them: `read_product()` -> `{module: Source}`."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PACKAGES = ("grmm_core", "grmm_blender", "operators", "grmm_studio", "tools")


@dataclass(frozen=True)
class Import:
    """One imported name.

    Attributes:
        importer: Module that imports, such as "grmm_core.head.flame".
        target: What it names: "grmm_core.head.head_model.HeadModel" for `from .model import HeadModel`.
        relative: Written with leading dots.
        line: In the source.
    """

    importer: str
    target: str
    relative: bool
    line: int


@dataclass(frozen=True)
class Source:
    """One file of the product."""

    name: str
    path: Path

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.path.read_text("utf-8"))

    @cached_property
    def imports(self) -> list[Import]:
        """Every import, also inside functions and for type checkers only."""
        found = []
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                found += [Import(self.name, alias.name, False, node.lineno) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                base = self._base(node)
                found += [Import(self.name, f"{base}.{alias.name}", node.level > 0, node.lineno) for alias in node.names]
        return found

    def _base(self, node: ast.ImportFrom) -> str:
        if not node.level:
            return node.module or ""
        parts = self.name.split(".")
        parts = parts[: len(parts) - node.level + self.is_package]
        return ".".join([*parts, node.module] if node.module else parts)

    @cached_property
    def texts(self) -> set[str]:
        """All string constants: modules are also started by name."""
        return {node.value for node in ast.walk(self.tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def read_sources(folder: Path) -> dict[str, Source]:
    """Every module below a folder of the repository, by its dotted name."""
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = Source(name, path)
    return found


def read_product() -> dict[str, Source]:
    """Every module of the packages; Blender's presets are scripts and none."""
    found = {name: source for package in PACKAGES for name, source in read_sources(ROOT / package).items()}
    return {name: source for name, source in found.items() if name in PACKAGES or name.rpartition(".")[0] in found}


def module_of(target: str, modules: dict[str, Source]) -> str | None:
    """The module that an imported name is, or is in; None outside the product."""
    while target and target not in modules:
        target = target.rpartition(".")[0]
    return target or None


def graph(modules: dict[str, Source]) -> dict[str, set[str]]:
    """The modules that each module imports by name."""
    return {
        name: {other for each in source.imports if (other := module_of(each.target, modules)) not in (None, name)}
        for name, source in modules.items()
    }


def circles(edges: dict[str, set[str]]) -> set[frozenset[str]]:
    """Groups of modules each of which imports itself by way of the others (Tarjan's strongly connected components)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: set[frozenset[str]] = set()

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(edges[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            position = stack.index(node)
            if len(stack) - position > 1:
                found.add(frozenset(stack[position:]))
            del stack[position:]

    for node in sorted(edges):
        if node not in index:
            visit(node)
    return found
