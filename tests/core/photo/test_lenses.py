"""Outlines of lenses: frames of any color are found, a bare face has none, and dark lenses hide what is behind. Drawn faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from drawn_glasses import with_glasses
from photo_parts import parts_of

from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head
from grmm_core.photo.glasses import thin_frames, worn_glasses
from grmm_core.photo.lenses import BROWS, EYES, lens_outlines
from grmm_core.pictures.polygons import polygon

SIZE = 320
SKIN = np.array([0.75, 0.58, 0.48])
METAL, AMBER, DARK = np.array([0.85, 0.85, 0.88]), np.array([0.62, 0.42, 0.2]), np.full(3, 0.06)


@dataclass(frozen=True, eq=False)
class Photo:
    """What is asked of a track."""

    image: np.ndarray
    landmarks: np.ndarray


def bare(size=SIZE, folds=False):
    """A shaded face with eyes and brows, grainy as photos are, with bags below the eyes if told, and its landmarks."""
    head = load_open_head()
    marks = Camera.orbit(size, size, 8.0, fov=18.0).project(head.landmark_positions(head.v_template, 478))[1]
    rows, columns = np.mgrid[:size, :size] + 0.5
    unit = np.linalg.norm(marks[263] - marks[33])
    light = 1.0 - 0.2 * np.abs(columns - marks[6, 0]) / size
    for outline in EYES:
        x, y = marks[list(outline)].mean(0)
        light[np.hypot((columns - x) / 0.17, (rows - y) / 0.07) < unit] = 0.4
        light[(np.abs(columns - x) < 0.22 * unit) & (np.abs(rows - y + 0.26 * unit) < 0.03 * unit)] = 0.5
        if folds:
            light[np.abs(np.hypot((columns - x) / 0.2, (rows - y) / 0.14) / unit - 1.0) < 0.05 * (rows > y)] *= 0.85
    grain = np.random.default_rng(0).normal(0.0, 0.01, (size, size, 1))
    return np.clip(light[..., None] * SKIN + grain, 0.0, 1.0), marks


@pytest.mark.parametrize("frame", [METAL, AMBER, DARK])
def test_lenses_are_found_in_frames_of_any_color(frame):
    image, marks = bare()
    worn, frames, lenses = with_glasses(image, marks, frame, 0.92, 0.3)
    found = lens_outlines(worn, marks)
    assert found is not None
    assert found.sure
    assert found.inside[lenses].mean() > 0.75
    assert (lenses | frames)[found.inside].mean() > 0.98
    assert (found.inside | found.frames)[frames].mean() > 0.93
    assert found.frames.sum() < 2.5 * frames.sum()
    assert not (found.frames & found.inside).any()


def test_a_bare_face_has_no_lenses():
    for folds in (False, True):
        assert lens_outlines(*bare(folds=folds)) is None
    image, marks = bare()
    small = with_glasses(image, marks, METAL)[0]
    assert lens_outlines(small[::6, ::6], marks / 6) is None, "too small to tell"


def test_skin_behind_clear_lenses_is_no_measure_and_dark_ones_hide_it():
    """The parser takes both for glasses."""
    image, marks = bare()
    for tint, clear in ((0.92, True), (0.2, False)):
        worn, frames, lenses = with_glasses(image, marks, DARK, tint)
        parts = parts_of(np.zeros((SIZE, SIZE)), glasses=(frames | lenses).astype(np.float32))
        found = worn_glasses(Photo(worn, marks), parts)
        assert found.covered[frames].mean() > 0.9
        assert not (found.covered & found.lenses).any()
        assert (found.covered | found.lenses)[frames | lenses].mean() > 0.97
        assert (found.lenses if clear else found.covered)[lenses].mean() > 0.75
        column, row = marks[152].astype(int)
        assert not (found.covered | found.lenses)[row, column], "the chin"


def test_what_is_above_brows_that_frames_hide_is_no_measure_either():
    image, marks = bare()
    worn, unit = with_glasses(image, marks, DARK)[0], np.linalg.norm(marks[263] - marks[33])
    middle = marks[list(EYES[0])].mean(0)
    for height, hidden in ((0.18, True), (0.36, False)):
        moved = marks.copy()
        for brow in BROWS:
            moved[list(brow), 1] += middle[1] - height * unit - moved[list(brow), 1].mean()
        found = worn_glasses(Photo(worn, moved), parts_of(np.zeros((SIZE, SIZE))))
        column, row = round(middle[0]), round(middle[1] - 0.31 * unit)
        assert found.lenses[row, column] == hidden


def test_a_bare_face_wears_none():
    image, marks = bare()
    found = worn_glasses(Photo(image, marks), parts_of(np.zeros((SIZE, SIZE))))
    assert not thin_frames(image, marks).any()
    assert not found.covered.any()
    assert not found.lenses.any()


def test_what_an_outline_encloses():
    square = np.array([[1.0, 2.0], [4.0, 2.0], [4.0, 5.0], [1.0, 5.0]])
    wanted = np.zeros((6, 7), bool)
    wanted[2:5, 1:4] = True
    np.testing.assert_array_equal(polygon((6, 7), square), wanted)
    assert polygon((6, 7), square + np.array([4.0, 2.0])).sum() == 4, "what is beyond the picture is not in it"
