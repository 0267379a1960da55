"""Recorded performances: reading, cleaning, reducing to keys, retargeting, writing.

=================  =====================================================================================
`types`            `Performance`, what everything here takes and returns
`reading`          `read_performance`: ARKit JSON, Live Link Face CSV, FLAME npz
=================  =====================================================================================

Called by the Blender importer and exporter and by the command line. Needs numpy only.
"""

from __future__ import annotations

from .reading import read_performance
from .types import Performance, Progress

__all__ = ["Performance", "Progress", "read_performance"]
