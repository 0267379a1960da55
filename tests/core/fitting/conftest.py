"""The open head and its landmarks, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from photo_parts import parts_of

from grmm_core.fitting import photo_targets
from grmm_core.fitting.point_rig import LandmarkRig
from grmm_core.fitting.types import PhotoTrack
from grmm_core.head import HeadModel
from grmm_core.head.open_head import load_open_head
from grmm_core.photo.parser import PhotoParts


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_open_head()


@pytest.fixture(scope="module")
def rig(head: HeadModel) -> LandmarkRig:
    return LandmarkRig(head)


@pytest.fixture(scope="module")
def only_skin() -> Iterator[None]:
    """Stands in for the photo parser, which knows people only: all of the person is skin."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(photo_targets, "parse", _only_skin)
        yield


def _only_skin(track: PhotoTrack, _: HeadModel) -> PhotoParts:
    return parts_of(1.0 - track.mask)
