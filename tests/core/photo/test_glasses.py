"""Thin frames of glasses: a bar over the nose is found, a bare face has none. Drawn faces."""

from __future__ import annotations

import numpy as np

from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head
from grmm_core.photo.glasses import EYES, thin_frames

SIZE = 256


def face(glasses: bool, wrinkle: bool = False):
    """Skin with eyes, brows and a shaded nose, with frames if told, and the landmarks."""
    head = load_open_head()
    marks = Camera.orbit(SIZE, SIZE, 8.0, fov=18.0).project(head.landmark_positions(head.v_template, 478))[1]
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    light = 0.7 - 0.1 * np.abs(columns - marks[6, 0]) / SIZE
    unit = np.linalg.norm(marks[263] - marks[33])
    for outline in EYES:
        x, y = marks[list(outline)].mean(0)
        light[np.hypot((columns - x) / 0.17, (rows - y) / 0.07) < unit] = 0.3
        light[(np.abs(columns - x) < 0.22 * unit) & (np.abs(rows - y + 0.26 * unit) < 0.03 * unit)] = 0.35
        if glasses:
            ring = np.abs(np.hypot((columns - x) / 0.27, (rows - y) / 0.2) / unit - 1.0) < 0.06
            light[ring] = 0.15
    if glasses:
        light[(np.abs(columns - marks[6, 0]) < 0.15 * unit) & (np.abs(rows - marks[6, 1]) < 0.02 * unit)] = 0.15
    if wrinkle:
        light[(np.abs(columns - marks[168, 0]) < 0.01 * unit) & (np.abs(rows - marks[168, 1]) < 0.1 * unit)] = 0.4
    return np.repeat(light[..., None], 3, 2), marks, unit


def test_frames_are_found_and_eyes_are_not():
    image, marks, unit = face(True)
    found = thin_frames(image, marks)
    assert found[image[..., 0] < 0.2].mean() > 0.8
    x, y = marks[list(EYES[0])].mean(0).astype(int)
    assert not found[y, x]
    assert found.sum() < unit**2


def test_wrinkles_behind_lenses_and_beside_them_are_no_frames():
    image, marks, unit = face(True)
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    folds = np.zeros((SIZE, SIZE), bool)
    for outline in EYES:
        x, y = marks[list(outline)].mean(0)
        folds |= (np.abs(columns - x) < 0.08 * unit) & (np.abs(rows - y - 0.12 * unit) < 0.01 * unit)
    image[folds] = 0.4
    found = thin_frames(image, marks)
    assert folds.any()
    assert not found[folds].any()
    assert found[image[..., 0] < 0.2].mean() > 0.8


def test_frames_are_found_on_both_sides_where_one_hangs_off_the_bar():
    image, marks, unit = face(True)
    left, right = (marks[list(outline)].mean(0)[0] for outline in EYES)
    gap = 0.5 * (left + right) - 0.16 * unit
    columns = np.mgrid[:SIZE, :SIZE][1] + 0.5
    image[np.abs(columns - gap) < 0.06 * unit] = 0.7  # a glint on the frame beside the nose
    found = thin_frames(image, marks)
    frames = image[..., 0] < 0.2
    for side in (columns < gap, columns > gap):
        assert found[frames & side].mean() > 0.7


def test_a_bare_face_has_no_frames():
    assert not thin_frames(*face(False)[:2]).any()
    assert not thin_frames(*face(False, wrinkle=True)[:2]).any()


def test_a_face_of_few_pixels_is_left_alone():
    image, marks, _ = face(True)
    assert not thin_frames(image[::8, ::8], marks / 8).any()
