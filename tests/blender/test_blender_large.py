"""A million splats and ten minutes of performance, imported into Blender; with `-s` it says in how much CPU time."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.formats import SplatCloud, write_splats

pytestmark = [pytest.mark.blender, pytest.mark.slow]

MILLION = 1_000_000
PATIENCE = 900.0  # seconds of waiting on a busy machine


def write_performance(path: Path) -> None:
    """Ten minutes at 60 frames per second of a face that talks, rests and blinks."""
    rng = np.random.default_rng(1)
    time = np.arange(36_000) / 60
    weights = 0.3 + 0.25 * np.sin(rng.uniform(0, 6, 52) + rng.uniform(1, 20, 52) * time[:, None])
    weights *= 0.5 + 0.5 * np.sin(0.5 * time[:, None])
    weights += rng.normal(0, 0.003, weights.shape)
    frames = [{"weights": row} for row in weights.round(4).tolist()]
    path.write_text(json.dumps({"names": list(ARKIT_NAMES), "metadata": {"fps": 60}, "frames": frames}))


def test_large_files(run_blender: RunBlender, tmp_path):
    rng = np.random.default_rng(0)
    cloud = SplatCloud.from_rgb(
        rng.normal(0, 0.5, (MILLION, 3)), rng.normal(size=(MILLION, 4)), np.full((MILLION, 3), 0.003),
        np.full(MILLION, 0.8), rng.uniform(0, 1, (MILLION, 3)),
    )  # fmt: skip
    write_splats(tmp_path / "million.ply", cloud)
    write_splats(tmp_path / "million.spz", cloud)
    write_performance(tmp_path / "long.json")
    result = run_blender("large_imports.py", tmp_path, timeout=PATIENCE).result
    for name in ("million.ply", "million.spz"):
        assert result[name]["count"] == MILLION
    for keys in ("FRAMES", "REDUCED"):
        assert result[keys]["end"] == 18_000
    sys.stdout.write("\n" + json.dumps(result))
