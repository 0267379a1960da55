"""A model of the tiny configuration on a head of 160 vertices, for the tests of this folder."""

from __future__ import annotations

import pytest
import torch
from model_fixtures import small_head

from grmm_core.head import HeadModel
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return small_head()


@pytest.fixture
def model(head: HeadModel) -> GRMM:
    torch.manual_seed(0)
    return GRMM(head, PRESETS["tiny"])
