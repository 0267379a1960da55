"""A `.grmm` avatar with every field set."""

from __future__ import annotations

import numpy as np

from grmm_core.avatar import AssetReference, Avatar, PhotoRecord, Provenance
from grmm_core.geometry.camera import Camera
from grmm_core.pictures.images import encode_png


def make_avatar(**changes) -> Avatar:
    rng = np.random.default_rng(7)
    fields = {
        "name": "Ünï 人",
        "head": AssetReference("open_head", "a" * 64),
        "weights": AssetReference("default", "0123456789abcdef" * 4),
        "z_id": rng.normal(size=32),
        "z_exp": rng.normal(size=16),
        "shape": rng.normal(size=300),
        "expression": rng.normal(size=52),
        "pose": rng.normal(size=(5, 3)),
        "camera": Camera.orbit(640, 480, yaw=12.0, pitch=-3.0, distance=0.8),
        "tracking": {"z_exp": rng.normal(size=(2, 16))},
        "deltas": {"opacity.layers.0.weight": rng.normal(size=(4, 3, 2, 2)) * 1e-3},
        "provenance": Provenance(
            "grmm 0.1.0", True, (PhotoRecord("me.jpg", "b" * 64), PhotoRecord("ich.png", "")), "2026-11-21", "with consent"
        ),
        "painting": rng.integers(0, 256, (8, 8, 3), np.uint8),
        "thumbnail": encode_png(np.zeros((4, 4, 3), np.uint8)),
    }
    return Avatar(**(fields | changes))
