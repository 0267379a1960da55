"""What every producer of progress keeps to."""

from __future__ import annotations

import math
from collections.abc import Sequence

from grmm_core.jobs.progress import Progress
from grmm_core.jobs.stages import JobStages


def check_progress(records: Sequence[Progress], stages: JobStages) -> None:
    """Stages of the table in its order, fractions 0..1 that never fall, times that are NaN or finite and not negative."""
    assert records
    places = [stages.position(record.stage) for record in records]
    assert places == sorted(places)
    fractions = [record.fraction for record in records]
    assert fractions == sorted(fractions)
    assert fractions[0] >= 0.0
    assert fractions[-1] <= 1.0
    for record in records:
        begin, end = stages.span(record.stage)
        assert begin - 1e-4 <= record.fraction <= end + 1e-4
        assert math.isnan(record.seconds_left) or 0.0 <= record.seconds_left < math.inf
