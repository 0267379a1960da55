"""Recorded performances that tests make: ARKit JSON, Live Link Face CSV, FLAME npz, and files that cannot be used."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES


def write_performances(folder: Path) -> None:
    """A talking face as ARKit JSON, a Live Link Face CSV, and files that cannot be used."""
    generator = np.random.default_rng(5)
    time = np.arange(241) / 30
    phase, speed = generator.uniform(0, 6, 52), generator.uniform(1, 6, 52)
    weights = 0.35 + 0.3 * np.sin(phase + speed * time[:, None])
    weights[:, 3] = 1.2  # out of range
    frames = [{"weights": [round(float(w), 5) for w in row], "time": float(t)} for row, t in zip(weights, time, strict=True)]
    text = json.dumps({"names": list(ARKIT_NAMES), "metadata": {"fps": 30}, "frames": frames})
    (folder / "speech.json").write_text(text)
    (folder / "truncated.json").write_text(text[: len(text) // 2])
    (folder / "empty.json").write_text(json.dumps({"names": list(ARKIT_NAMES), "frames": []}))

    names = [name[0].upper() + name[1:] for name in ARKIT_NAMES]
    parts = [f"{part}{axis}" for part in ("Head", "LeftEye", "RightEye") for axis in ("Yaw", "Pitch", "Roll")]
    rows = [",".join(["Timecode", "BlendShapeCount", *names, *parts])]
    for k in range(120):
        values = [0.25 if name.startswith("MouthSmile") else 0.1 for name in names]
        angles = [0.01 * k, 0.05, 0.0] + [0.1, -0.05, 0.0] * 2
        rows.append(f"10:00:{k // 60:02d}:{k % 60:02d}.000,61," + ",".join(f"{v:.5f}" for v in values + angles))
    (folder / "live_link.csv").write_text("\n".join(rows))
    (folder / "unknown.csv").write_text("Timecode,Wobble\n10:00:00:00.000,0.5\n")
    zeros = np.zeros((10, 3), np.float32)
    generator = np.random.default_rng(6)
    np.savez(
        folder / "talk.npz",
        expr=generator.normal(0, 0.5, (10, 100)).astype(np.float32),
        rotation=generator.normal(0, 0.1, (10, 3)),
        neck_pose=generator.normal(0, 0.1, (10, 3)),
        jaw_pose=np.abs(generator.normal(0, 0.1, (10, 3))) * [1, 0, 0],
    )
    np.savez(folder / "flame.npz", expr=np.ones((10, 100), np.float32), rotation=zeros, neck_pose=zeros, jaw_pose=zeros)
