"""The text of the CUDA kernels with its constants in front, and the sizes that the kernels and their callers share.

Needs numpy only: the tests compile the text without CUDA. Used by `compile.py` and `drawing.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .. import rules
from ..rules import View

KERNELS = ("project", "list_tiles", "blend", "replay", "collect")
THREADS = rules.TILE**2  # of a block: a tile's pixels, or as many Gaussians
WARP = 32
RECORD = 12  # floats of a projected Gaussian
BASE = 4  # channels before the features: r, g, b, depth
MOMENTS = 6  # sums in front of the channels' gradients in a row
FEATURES_MAX = 8 * WARP - MOMENTS - BASE  # what a thread's registers and a block's shared memory are reckoned for
FAR_AWAY = 1e9  # pixels; Gaussians projected farther out or larger than this are dropped
_SHARED_SUMS = 4096  # floats of shared memory for sums over warps


def row_length(features: int) -> int:
    """Return the floats of a gradient row: moments, then the channels."""
    return MOMENTS + BASE + features


def kernel_source(features: int) -> str:
    """Return the CUDA C++ text of the kernels for pictures with `features` channels beside color and depth."""
    row = row_length(features)
    parts = -(-row // WARP) * WARP
    numbers: dict[str, float | int] = {
        name: getattr(rules, name)
        for name in ("DILATION", "ALPHA_MIN", "TRANSMITTANCE_MIN", "NEAR", "COMPENSATION_MIN", "TILE")
    }
    numbers |= {
        "FAR_AWAY": FAR_AWAY, "THREADS": THREADS, "FEATURES": features, "BASE": BASE, "CHANNELS": BASE + features,
        "MOMENTS": MOMENTS, "ROW": row, "PARTS": parts, "TOGETHER": max(1, _SHARED_SUMS // (THREADS // WARP * parts)),
    }  # fmt: skip
    defined = "".join(f"#define {name} {value!r}\n" for name, value in numbers.items())
    return defined + Path(__file__).with_name("kernels.cu").read_text(encoding="utf-8")


def camera_block(view: View, antialiased: bool) -> np.ndarray:
    """Return a view as the kernels' struct Camera: 24 float64 numbers."""
    numbers = (view.fx, view.fy, view.cx, view.cy, *view.clamp, view.width, view.height, view.orthographic, antialiased)
    return np.concatenate([view.rotation.reshape(9), view.translation, np.array(numbers, np.float64)])
