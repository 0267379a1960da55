"""Blender as people have it, with numpy and nothing else, and the zip that carries its own libraries."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest
from blender_process import ROOT, STOCK, run_alone

PLATFORMS = {("linux", "x86_64"): "linux-x64", ("win32", "AMD64"): "windows-x64", ("darwin", "arm64"): "macos-arm64"}


@pytest.mark.parametrize(("version", "python"), [("4.5", "py311"), ("5.2", "py313")])
def test_the_zip_alone_draws_a_face(version, python, tmp_path):
    here = PLATFORMS.get((sys.platform, platform.machine()))
    if here is None:
        pytest.skip("no zip with wheels is made for this platform")
    command = [sys.executable, "-m", "tools.release", "--output", str(tmp_path), "--only", f"{here}-{python}"]
    made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert made.returncode == 0, made.stderr
    zips = list(tmp_path.glob("*.zip"))
    assert len(zips) == 1
    result = run_alone("stock_render.py", zips[0], tmp_path / "face.png", python=STOCK[version]).result
    assert (result["torch"], result["here"]) == (False, False)
    assert (result["kind"], result["engine"]) == ("worker", "plain")
    red, green, blue, alpha = result["middle"]
    assert alpha > 0.99
    assert red > green > blue > 0.1  # skin
    assert 0.2 < result["alpha"] < 0.9
