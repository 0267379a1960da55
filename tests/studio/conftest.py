"""What the studio's tests share: the open head, and its mesh for Cycles."""

from __future__ import annotations

import pytest

from grmm_core.head.head_model import HeadModel
from grmm_core.head.open_head import load_open_head
from grmm_studio.mesh import RenderMesh


@pytest.fixture(scope="session")
def head() -> HeadModel:
    return load_open_head()


@pytest.fixture(scope="session")
def render_mesh(head: HeadModel) -> RenderMesh:
    return RenderMesh.build(head)
