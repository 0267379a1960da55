"""The tolerances of the tests that more than one of them uses or that the documentation promises, with their reasons."""

from __future__ import annotations

# The CPU and CUDA rasterisers work in single precision, the reference in double; relative to the largest value of a picture.
# The README states both.
SPLAT_PICTURE = 3e-5
SPLAT_GRADIENT = 5e-4

# The quality gate allows for another processor's rounding and for changes that only reorder sums, both far smaller; what is
# lost by a real mistake is more. PSNR in dB; share of an opacity, a distance, an RMSE.
QUALITY_DECIBELS = 0.2
QUALITY_SHARE = 0.05
