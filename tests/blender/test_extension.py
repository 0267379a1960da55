"""The built extension as a user meets it: it validates, installs, enables, disables and goes, on every supported Blender."""

from __future__ import annotations

import tomllib
import zipfile

import pytest
from blender_process import RunBlender, extension_zip

import grmm_core

pytestmark = pytest.mark.blender


def test_zip_holds_the_extension_and_nothing_else():
    with zipfile.ZipFile(extension_zip()) as archive:
        names = archive.namelist()
    assert {"blender_manifest.toml", "LICENSE", "__init__.py", "grmm_blender/__init__.py", "grmm_core/__init__.py"} <= {*names}
    top = {name.split("/")[0] for name in names}
    assert top <= {"blender_manifest.toml", "__init__.py", "LICENSE", "grmm_core", "grmm_blender", "operators"}
    assert not [n for n in names if "__pycache__" in n or n.endswith((".pyc", ".tmp")) or "/." in n]


def test_the_manifest_has_the_package_s_version_and_reasons_that_fit(repository):
    manifest = tomllib.loads((repository / "blender_manifest.toml").read_text("utf-8"))
    assert manifest["version"] == grmm_core.__version__
    heading = next(line for line in (repository / "CHANGELOG.md").read_text("utf-8").splitlines() if line.startswith("## "))
    assert heading.removeprefix("## ").startswith(grmm_core.__version__)
    for text in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(text) <= 64  # Blender's limit
        assert not text.endswith(".")


def test_lifecycle(run_blender: RunBlender, blender_version: str):
    result = run_blender("extension_lifecycle.py", python=blender_version, fresh=True, enable=False, timeout=90).result
    assert result["heavy"] == []
    assert result["warnings"] == {}
    assert "GRMM_RenderEngine" in result["registered"]
    assert result["after_disable"] == []
    assert "switched off" in result["session_while_off"]
    assert "switched off" not in result["session_while_on"]
    assert result["temporary"] == result["registered"]
    assert result["device"] == "auto"
    assert result["after_enable"] == result["registered"]
    assert result["after_uninstall"] == []
    assert not result["folder_left"]
    assert not result["enabled"]
