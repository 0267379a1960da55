"""The open head and its landmarks, for the tests of this folder."""

from __future__ import annotations

import pytest

from grmm_core.fitting.point_rig import LandmarkRig
from grmm_core.head import HeadModel
from grmm_core.head.open_head import load_open_head


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_open_head()


@pytest.fixture(scope="module")
def rig(head: HeadModel) -> LandmarkRig:
    return LandmarkRig(head)
