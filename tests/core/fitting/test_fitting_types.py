"""Tracks and their file."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from grmm_core.errors import FileAccessError, FileFormatError, ShapeError
from grmm_core.files.tensorfile import read_tensors, write_tensors
from grmm_core.fitting.types import PhotoTrack, load_tracks, save_tracks
from grmm_core.geometry.camera import Camera


def make_track(seed=0, size=24):
    g = np.random.default_rng(seed)
    camera = Camera.orbit(size, size, yaw=12.0)
    return PhotoTrack(
        source="Übergröße.jpg", image=g.uniform(size=(size, size, 3)), mask=g.uniform(size=(size, size)),
        valid=np.ones((size, size)), camera=camera, photo_camera=camera.resized(90, 80), shape=g.normal(size=300),
        expression=g.uniform(size=100), pose=g.normal(size=(5, 3)), landmarks=g.uniform(0, size, (478, 2)),
        landmarks_fitted=g.uniform(0, size, (478, 2)), arkit=g.uniform(size=52),
        presence=0.75,
    )  # fmt: skip


def test_tracks_come_back_exactly(tmp_path):
    placed = {"placed": np.full((478, 2), 3.0), "placed_sigma": np.full(478, 0.5)}
    tracks = [make_track(0), replace(make_track(1), identity=np.arange(8.0), **placed)]
    save_tracks(tmp_path / "tracks.safetensors", tracks)
    loaded = load_tracks(tmp_path / "tracks.safetensors")
    assert len(loaded) == 2
    for track, back in zip(tracks, loaded, strict=True):
        for item in fields(track):
            before, after = getattr(track, item.name), getattr(back, item.name)
            if isinstance(before, Camera):
                np.testing.assert_array_equal(after.world_to_camera, before.world_to_camera)
                assert (after.fx, after.cy, after.width, after.height) == (before.fx, before.cy, before.width, before.height)
            elif isinstance(before, np.ndarray):
                np.testing.assert_array_equal(after, before)
            else:
                assert after == before


def test_landmark_error_is_relative_to_the_eyes():
    track = make_track()
    found = np.zeros((478, 2), np.float32)
    found[263, 0] = 50.0
    assert replace(track, landmarks=found, landmarks_fitted=found + np.array([3.0, 4.0])).landmark_error == pytest.approx(0.1)


def test_the_heads_landmarks_lie_in_the_photo_as_in_the_working_picture():
    track = replace(make_track(), photo_camera=make_track().camera.resized(90, 90))
    assert track.placed_in_photo is None
    points = track.camera.project(np.random.default_rng(0).normal(0.0, 0.05, (478, 3)))[1]
    track = replace(track, placed=points, placed_sigma=np.full(478, 2.0))
    scale = track.photo_camera.fx / track.camera.fx
    wanted = track.photo_camera.project(np.random.default_rng(0).normal(0.0, 0.05, (478, 3)))[1]
    np.testing.assert_allclose(track.placed_in_photo.points, wanted, atol=1e-3)
    np.testing.assert_allclose(track.placed_in_photo.sigma, 2.0 * scale, rtol=1e-6)


def test_wrong_shapes_and_numbers_are_refused():
    track = make_track()
    with pytest.raises(ShapeError, match="mask"):
        replace(track, mask=np.zeros((3, 3)))
    with pytest.raises(ShapeError, match="finite"):
        replace(track, shape=np.full(300, np.nan))


def test_damaged_files_are_one_sentence(tmp_path):
    path = tmp_path / "tracks.safetensors"
    with pytest.raises(FileAccessError):
        load_tracks(path)
    save_tracks(path, [make_track()])
    tensors, metadata = read_tensors(path)
    write_tensors(path, tensors, metadata | {"version": "99"})
    with pytest.raises(FileFormatError, match="fit the photos again"):
        load_tracks(path)
    del tensors["0.pose"]
    write_tensors(path, tensors, metadata)
    with pytest.raises(FileFormatError, match="damaged"):
        load_tracks(path)
