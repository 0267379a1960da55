"""How an avatar's hair is like that of its photo: the same groom is, another is not, and where none shows nothing is said."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from photo_parts import parts_of

from grmm_core.evaluation.cleanliness import Shot
from grmm_core.evaluation.photo_fits import hair_figures
from grmm_core.fitting.types import LANDMARK_COUNT, PhotoTrack
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.coloring import WornHair
from grmm_core.head import load_open_head
from grmm_core.model.portrait import portrait_camera

SIDE = 320


class Worn:
    """In the place of `photo_fits.Worn`: a groom on the mean head."""

    def __init__(self, name: str) -> None:
        self.head = load_open_head()
        self._vertices, self._groom = np.asarray(self.head.v_template, np.float64), library_groom(name)

    def photo(self, camera, hair=None):
        settings = HairSettings(melanin=0.4)
        rgb, cover = WornHair(self._groom, settings, self._vertices, camera, self.head).drawn(settings)
        return Shot(self._vertices, camera, rgb + (1.0 - cover[..., None]) * 0.6, cover, cover)


@pytest.fixture(scope="module")
def track():
    worn, camera = Worn("side_part"), portrait_camera(SIDE)
    shot, head = worn.photo(camera), worn.head
    labels = dataclasses.asdict(parts_of(np.zeros((SIDE, SIDE), np.float32), hair=shot.hair))
    zeros = {"shape": np.zeros(head.shape_count), "expression": np.zeros(head.expression_count), "pose": np.zeros((5, 3))}
    marks, whole = np.zeros((LANDMARK_COUNT, 2)), np.ones((SIDE, SIDE), np.float32)
    return PhotoTrack(
        source="", image=shot.rgb, mask=whole, valid=whole, camera=camera, photo_camera=camera, landmarks=marks,
        landmarks_fitted=marks, arkit=np.zeros(52), labels=np.stack(list(labels.values())), **zeros,
    )  # fmt: skip


def test_the_same_hair_and_other_hair(track):
    same, other = hair_figures(track, Worn("side_part")), hair_figures(track, Worn("afro"))
    assert same["hair_overlap"] > 0.9  # the edges of labels are hardened
    assert same["hair_rmse"] < 0.04 < 0.5 * other["hair_rmse"]
    assert same["hair_turned"] < 2.0
    assert other["hair_overlap"] < 0.8
    assert other["hair_turned"] > 15.0


def test_hair_that_hardly_shows_has_no_figures(track):
    assert hair_figures(dataclasses.replace(track, labels=track.labels * 0.0), Worn("side_part")) == {}
