"""The public names of the core: what others may import from it. Changing the list is a deliberate edit of a committed file.

`python tests/core/test_public_names.py` writes `tests/data/public_names.txt` anew.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIST = ROOT / "tests" / "data" / "public_names.txt"
# Rooms without `__all__` are entered by these modules; every name that they define without an underscore counts.
ENTRIES = (
    "controls.frame",
    "data.dataset",
    "data.types",
    "errors",
    "evaluation.protocols",
    "fitting.api",
    "geometry.camera",
    "training.trainer",
)


def defined(tree: ast.Module) -> list[str]:
    """Functions, classes and constants of a module."""
    names = [node.name for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))]
    targets = [target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets]
    targets += [node.target for node in tree.body if isinstance(node, ast.AnnAssign)]
    return [*names, *(target.id for target in targets if isinstance(target, ast.Name))]


def exported(tree: ast.Module) -> list[str] | None:
    """What `__all__` lists, or None without one."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return ast.literal_eval(node.value)
    return None


def public_names() -> str:
    """A line for each room or module: its name, and the names that it gives."""
    lines = []
    for path in sorted((ROOT / "grmm_core").rglob("*.py")):
        module = ".".join(path.relative_to(ROOT / "grmm_core").with_suffix("").parts).removesuffix(".__init__")
        tree = ast.parse(path.read_text("utf-8"))
        names = exported(tree)
        if names is None and module in ENTRIES:
            names = [name for name in defined(tree) if not name.startswith("_") and name != "logger"]
        if names is not None:
            lines.append(f"{module}: {' '.join(sorted(names))}")
    return "\n".join(lines) + "\n"


def test_the_public_names_are_those_of_the_list():
    assert public_names().splitlines() == LIST.read_text("utf-8").splitlines()


if __name__ == "__main__":
    sys.exit(LIST.write_text(public_names(), "utf-8") == 0)
