"""The tolerances of the tests that more than one of them uses or that the documentation promises, with their reasons."""

from __future__ import annotations

# The CPU and CUDA rasterisers work in single precision, the reference in double; relative to the largest value of a picture.
# The README states both.
SPLAT_PICTURE = 3e-5
SPLAT_GRADIENT = 5e-4
