"""The laws of the house, read from the sources: who may import whom, what importing loads, what nobody needs, names.

Violations that are known stand in the table below each law; a test fails as well when an entry is no longer needed.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib

import pytest
from import_graph import PACKAGES, ROOT, Source, circles, graph, module_of, read_product, read_sources


def package_of(module: str) -> str:
    return module.split(".")[0]


def room_of(module: str) -> str:
    return module.split(".")[1]


MODULES = read_product()
EDGES = graph(MODULES)
CORE = {name: source for name, source in MODULES.items() if name.startswith("grmm_core.")}
EXTENSION = {n: source for n, source in MODULES.items() if package_of(n) in ("grmm_core", "grmm_blender", "operators")}
REGISTERED = Source("", ROOT / "__init__.py").texts  # the extension's entry point names what it registers
DOCUMENTATION = "".join(path.read_text("utf-8") for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])


# --- the maps of the core and of the Blender half ----------------------------------------------------------------------


def rooms_of_the_map(package: str) -> list[str]:
    """Rooms from the ground up: the names that begin the lines of the docstring's map."""
    text = ast.get_docstring(ast.parse((ROOT / package / "__init__.py").read_text("utf-8"))) or ""
    rows = re.findall(r"^((?:``\w+`` *)+)  ", text, re.MULTILINE)
    return [name for row in rows for name in re.findall(r"``(\w+)``", row)]


@pytest.mark.parametrize("package", ["grmm_core", "grmm_blender"])
def test_the_map_names_every_room(package):
    folders = {path.name for path in (ROOT / package).iterdir() if (path / "__init__.py").exists()}
    modules = {path.stem for path in (ROOT / package).glob("*.py")} - {"__init__", "__main__"}
    assert set(rooms_of_the_map(package)) == folders | modules


@pytest.mark.parametrize("package", ["grmm_core", "grmm_blender"])
def test_rooms_import_only_rooms_above_them_in_the_map(package):
    order = {room: place for place, room in enumerate(rooms_of_the_map(package))}
    order["__main__"] = len(order)
    modules = {name: source for name, source in MODULES.items() if name.startswith(f"{package}.")}
    wrong = {
        f"{each.importer}:{each.line} imports {target}"
        for name, source in modules.items()
        for each in source.imports
        if (target := module_of(each.target, modules)) and "." in target and room_of(target) != room_of(name)
        if order[room_of(target)] > order[room_of(name)]
    }
    assert wrong == set()


def test_no_file_imports_itself_by_way_of_others():
    assert circles(EDGES) == set()


# --- between the packages --------------------------------------------------------------------------------------------

# `grmm capture` starts the studio, which is there when the core is installed by pip and not in the extension.
STUDIO_STARTS = {"grmm_core.cli.capture"}


def test_the_core_imports_neither_blender_nor_what_is_built_on_it():
    others = ("bpy", "bmesh", "mathutils", "gpu", "bl_ui", "grmm_blender", "operators", "tools", "grmm_studio")
    wrong = {name for name, source in CORE.items() for each in source.imports if each.target.split(".")[0] in others}
    assert wrong == STUDIO_STARTS


def test_the_extension_imports_itself_relatively():
    """Blender gives it the name `bl_ext.user_default.grmm`, so that an absolute name would find another copy or none."""
    wrong = {
        name
        for name, source in EXTENSION.items()
        for each in source.imports
        if not each.relative and module_of(each.target, MODULES) and not each.target.startswith("grmm_studio")
    }
    assert wrong == set()


def test_nothing_calls_back_into_the_operators():
    """Operators are how users reach the extension; what two of them share lies below them in `grmm_blender`."""
    wrong = {
        name
        for name, source in MODULES.items()
        if name.startswith("grmm_blender.")
        if any(target.startswith("operators") for target in EDGES[name])
        or re.search(r"bpy\.ops\.grmm\.\w+\(", source.path.read_text("utf-8"))
    }
    assert wrong == set()


# What the packages import from PyPI by another name than it is installed under, or without an extra of theirs.
DISTRIBUTIONS = {"PIL": "pillow", "llvmlite": "numba", "mathutils": "bpy", "dask": "distributed"}
# a faster way on a graphics card; version 4 of SPZ; a face-recognition network of 100 MB. All say so when missing.
LEFT_TO_THE_USER = {"gsplat", "zstandard", "dlib"}


@pytest.mark.parametrize(
    ("package", "extras"), [("grmm_core", ("train", "data", "cluster", "exr")), ("grmm_studio", ("studio",))]
)
def test_what_a_package_imports_is_declared(package, extras):
    """Each extra is tried in an environment of its own by `tests/test_install.py`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    declared = [*project["dependencies"], *(line for extra in extras for line in project["optional-dependencies"][extra])]
    known = {re.split(r"[<>=]", line)[0] for line in declared} | LEFT_TO_THE_USER
    imported = {
        each.target.split(".")[0]
        for name, source in MODULES.items()
        for each in source.imports
        if package_of(name) == package and not each.relative
    }
    foreign = imported - set(sys.stdlib_module_names) - set(PACKAGES)
    assert {name for name in foreign if DISTRIBUTIONS.get(name, name) not in known} == set()


# --- what importing loads --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "statement",
    [
        "import grmm_core",
        "import grmm_core.performance, grmm_core.formats; grmm_core.formats.formats()",
        "from grmm_core.cli import main; main(['render', '--help'])",
        "import grmm_core.session, grmm_core.compute.devices",
        "from grmm_core.model import config, detail, inputs, layout, parameters, people, portrait, weights_file",
    ],
)
def test_importing_loads_nothing_heavy(statement):
    """Registering the extension likewise: `tests/blender/test_extension.py`."""
    heavy = {"torch", "numba", "bpy", "scipy", "PIL", "zstandard", "trimesh", "grmm_studio"}
    code = f"import sys; {statement}; print(sorted({heavy} & set(sys.modules)))"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


# --- what nobody needs -----------------------------------------------------------------------------------------------


def starts_by_itself(name: str) -> bool:
    """A package or a program, or what registration, the command line or the documentation finds by name."""
    source = MODULES[name]
    text = source.path.read_text("utf-8")
    if source.is_package or name.endswith("__main__") or '__name__ == "__main__"' in text or f".{name}" in REGISTERED:
        return True
    parent, _, last = name.rpartition(".")
    while parent:
        beside = [each for other, each in MODULES.items() if parent in (other, other.rpartition(".")[0])]
        if any({f".{last}", last} & each.texts and "import_module" in each.path.read_text("utf-8") for each in beside):
            return True
        parent, _, above = parent.rpartition(".")
        last = f"{above}.{last}"
    return str(source.path.relative_to(ROOT)) in DOCUMENTATION


def test_no_module_is_there_for_tests_only():
    imported = set().union(*EDGES.values())
    assert {name for name in MODULES if name not in imported and not starts_by_itself(name)} == set()


# --- names -----------------------------------------------------------------------------------------------------------

# Names that say a module's place in its room, and mean the same in every room that has one.
PLACES = {
    "__main__": "a program",
    "api": "what other rooms call",
    "build": "makes the room's objects in Blender",
    "checkpoint": "the state of interrupted work",
    "config": "what is chosen before a run",
    "drawing": "how a backend draws",
    "job": "work in a process of its own",
    "panel": "a room's panel",
    "properties": "property groups",
    "request": "what is asked of a kind of work",
    "settings": "property groups of the scene",
    "types": "a room's data classes",
    "watch": "what becomes of a job",
}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_two_modules_of_a_package_share_a_name(package):
    """Modules of `cli` have the names of their commands."""
    names = [n.rpartition(".")[2] for n in MODULES if package_of(n) == package and not n.startswith("grmm_core.cli.")]
    assert {name for name in names if names.count(name) > 1} <= PLACES.keys()


def test_no_test_imports_a_test():
    tests = read_sources(ROOT / "tests")
    stems = {source.path.stem for source in tests.values() if source.path.stem.startswith("test_")}
    wrong = {name for name, source in tests.items() for each in source.imports if each.target.split(".")[0] in stems}
    assert wrong == set()
