"""Recorded performances: cleaning, reducing to keys, retargeting. `formats` reads and writes them.

=================  =====================================================================================
`types`            `Performance`, what everything here takes and returns
`timing`           `resample`, `shift`, `trim`
`editing`          `apply_gain`, `find_neutral_frames`, `calibrate_neutral`, `clamp`, `REGIONS`
`smoothing`        `smooth`
`closures`         `lip_model`, `keep_lips_closed`
`curves`           `reduce_curves`: keys to a stated error
`retarget`         `to_expression`, `to_arkit`
`recording`        `record`, `record_expression`: controls of frames become a performance
`pipeline`         `clean`: all of the cleaning in one call
=================  =====================================================================================

Called by the Blender importer and exporter and by the command line. Needs numpy only.

A usual import: `formats.read_performance`, `clean`, `reduce_curves`.
"""

from __future__ import annotations

from .curves import ReducedCurve, reduce_curves
from .editing import REGIONS, apply_gain, calibrate_neutral, clamp, find_neutral_frames
from .pipeline import CleanOptions, clean
from .retarget import to_arkit, to_expression
from .smoothing import smooth
from .timing import resample, shift, trim
from .types import Performance

__all__ = [
    "REGIONS",
    "CleanOptions",
    "Performance",
    "ReducedCurve",
    "apply_gain",
    "calibrate_neutral",
    "clamp",
    "clean",
    "find_neutral_frames",
    "reduce_curves",
    "resample",
    "shift",
    "smooth",
    "to_arkit",
    "to_expression",
    "trim",
]
