"""The bust is open below, and its inside is not drawn: a shipped avatar, looked at from below and from behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.controls.frame import Controls
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.head import load_open_head
from grmm_core.session import HairUse, Instance, RenderOptions, create_session
from grmm_core.session.exporting import splat_cloud

BARE = HairUse("none", brows="none", beard="none", lashes="none")
ANGLES = ((60.0, -25.0), (150.0, 0.0), (200.0, -25.0))  # degrees, where a part of the inside is in sight


@pytest.fixture(scope="module", params=["torch", "plain"])
def session(request):
    with create_session("local", engine=request.param) as session:
        yield session


def sides(camera: Camera, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that see the inside of the bust before nothing, and those that see the outside of skin, [H, W] bool."""
    head = load_open_head()
    corners = vertices[head.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = -camera.forward if camera.orthographic else camera.position - corners.mean(1)
    outside = (normals * towards).sum(1) > 0
    bust = head.marked("neck")[head.faces].all(1)
    shown, hollow = (triangle_depth(corners[which], camera) for which in (outside, bust & ~outside))
    return (hollow < EMPTY) & (shown == EMPTY), shown < hollow


@pytest.mark.parametrize("angles", ANGLES)
@pytest.mark.parametrize(("parallel", "lod"), [(False, 0), (False, 1), (True, 0)])
def test_nothing_is_seen_of_the_inside(session, angles, parallel, lod):
    """It was a black hollow in the light of a scene."""
    avatar = session.open("library:grey")
    camera = Camera.orbit(160, 160, *angles, distance=1.15, fov=24.0)
    if parallel:
        camera = replace(camera, fx=camera.fx / 1.15, fy=camera.fy / 1.15, orthographic=True)
    inside, skin = sides(camera, session.deform(avatar.id, Controls()).vertices)
    assert inside.sum() > 60
    alpha = session.render([Instance(avatar.id, hair=BARE)], camera, RenderOptions(False, ("alpha",), lod))["alpha"][..., 0]
    assert alpha[inside].mean() < 0.2
    assert alpha[skin].mean() > 0.97


def test_from_far_below_nobody_looks_into_the_head(session):
    """Without the front's inside, the face was seen from within."""
    avatar, camera = session.open("library:grey"), Camera.orbit(160, 160, 180.0, -45.0, distance=1.15, fov=24.0)
    inside, _ = sides(camera, session.deform(avatar.id, Controls()).vertices)
    assert inside.sum() > 60
    alpha = session.render([Instance(avatar.id, hair=BARE)], camera, RenderOptions(False, ("alpha",)))["alpha"][..., 0]
    assert alpha[inside].mean() > 0.9


def test_who_looks_from_one_side_gets_that_side_and_exports_have_all(session):
    avatar = session.open("library:grey")
    everything = session.gaussians(avatar.id, Controls(), hair=BARE)
    behind = session.gaussians(avatar.id, Controls(), np.array([0.0, 0.0, -1.0]), hair=BARE)
    np.testing.assert_array_equal(everything.means, behind.means)
    less = behind.opacities < 0.5 * everything.opacities
    chest = (everything.means[:, 1] < -0.12) & (everything.means[:, 2] > 0.05)
    assert less[chest].mean() > 0.95
    assert not less[everything.means[:, 1] > 0.05].any()
    assert (splat_cloud(session, avatar, Controls(), 0, hair=BARE).opacities[chest] > 0.3).mean() > 0.95
