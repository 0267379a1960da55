"""The tolerances of the tests that more than one of them uses or that the documentation promises, with their reasons."""

from __future__ import annotations

# The CPU and CUDA rasterisers work in single precision, the reference in double; relative to the largest value of a picture.
# The README states both.
SPLAT_PICTURE = 3e-5
SPLAT_GRADIENT = 5e-4

# Vertices that Blender evaluates against the core's, metres: both compute in single precision, 2e-7 relative, over a chain of
# sums and five joints. The README states it.
RIG_PARITY = 1e-5

# Of an 8-bit channel: two pictures of one frame may be rounded to neighbouring values, and no further.
CHANNEL_STEP = 1.0 + 1e-3

# The quality gate allows for another processor's rounding and for changes that only reorder sums, both far smaller; what is
# lost by a real mistake is more. PSNR in dB; share of an opacity, a distance, an RMSE.
QUALITY_DECIBELS = 0.2
QUALITY_SHARE = 0.05
