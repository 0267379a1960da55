"""Marks and make-up: the same again, different from person to person, make-up where it belongs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.head.open_head import load_people_model
from grmm_studio import marks
from grmm_studio.marks import Canvas, paint_marks
from grmm_studio.subjects import Subject, draw_subject, skin_albedo

LASH_LINE = np.array([[0.02, 0.040, 0.095], [0.03, 0.042, 0.095]])


def canvas(subject: Subject) -> Canvas:
    """A flat face of even skin."""
    x, y = np.meshgrid(np.linspace(-0.07, 0.07, 141), np.linspace(-0.09, 0.11, 201))
    rest = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.095)], 1)
    color = np.broadcast_to(skin_albedo(subject.melanin, subject.blood), rest.shape).copy()
    return Canvas(rest, color, np.zeros(len(rest)), np.full(len(rest), 0.5))


def painted(subject: Subject) -> Canvas:
    result = canvas(subject)
    lips = (np.hypot(result.rest[:, 0] / 0.022, (result.rest[:, 1] + 0.0325) / 0.009) < 1).astype(float)
    paint_marks(subject, result, lips, LASH_LINE)
    return result


@pytest.fixture(scope="module")
def woman() -> Subject:
    return next(s for s in (draw_subject(5, i, load_people_model()) for i in range(2)) if s.female)


def test_marks_are_repeatable_and_personal(woman):
    one, again, other = painted(woman), painted(woman), painted(replace(woman, asymmetry=woman.asymmetry + 1))
    np.testing.assert_array_equal(one.color, again.color)
    assert np.abs(one.color - other.color).max() > 0.05
    assert np.isfinite(one.height).all()
    assert np.abs(one.height).max() < 0.003


def test_make_up_is_where_it_belongs(woman, monkeypatch):
    def lips_change(share: float) -> tuple[float, float]:
        monkeypatch.setattr(marks, "MADE_UP", {True: share, False: share})
        lips, brow = [], []
        for seed in range(12):
            result = painted(replace(woman, asymmetry=seed, spots=0.0))
            change = np.abs(result.color - canvas(woman).color).mean(1)
            x, y = result.rest[:, 0], result.rest[:, 1]
            lips.append(np.median(change[(np.abs(x) < 0.01) & (np.abs(y + 0.0325) < 0.004)]))
            brow.append(np.median(change[(np.abs(x) < 0.03) & (y > 0.08)]))
        return float(np.mean(lips)), float(np.mean(brow))

    made_up, bare = lips_change(1.0), lips_change(0.0)
    assert made_up[0] > bare[0] + 0.05  # lips are painted
    assert made_up[1] < bare[1] + 0.01  # the forehead is not
