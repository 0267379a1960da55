"""Splats as other programs draw them, and levels of detail, beside the avatar: the shipped weights, looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.controls.frame import Controls
from grmm_core.geometry.camera import Camera
from grmm_core.session import CloudArrays, HairUse, Instance, RenderOptions, create_session
from grmm_core.session.exporting import splat_cloud

BARE = HairUse("none", brows="none", beard="none", lashes="none")
PLAIN = RenderOptions(refine=False, background=(1.0, 1.0, 1.0))


@pytest.fixture(scope="module")
def session():
    with create_session("local") as session:
        yield session


def picture(session, number: int, camera: Camera, hair: HairUse = BARE, options: RenderOptions = PLAIN) -> np.ndarray:
    return session.render([Instance(number, hair=hair)], camera, options)["rgb"]


def test_a_plain_renderer_shows_the_eyes_and_brows_of_the_avatar(session):
    """Thin Gaussians are drawn wider by who does not compensate for it: irises were darker by a quarter of white."""
    avatar, hair = session.open("default"), HairUse("none", beard="none")
    cloud = splat_cloud(session, avatar, Controls(), 2, hair=hair)
    number = session.put_cloud("file", "1", CloudArrays(cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh))
    eyes = Camera.orbit(384, 384, yaw=0, pitch=0, distance=1.1, fov=17)
    own, theirs = picture(session, avatar.id, eyes, hair), picture(session, number, eyes)
    assert float(np.abs(own - theirs).mean()) < 0.0035
    iris = own[..., 2] - own[..., 0] > 0.05
    assert iris.sum() > 80
    assert float((own - theirs)[iris].mean()) < 0.15


@pytest.mark.parametrize(
    ("lod", "size", "colors", "fog"), [(1, 256, 0.012, 0.006), (2, 128, 0.024, 0.02), (3, 64, 0.041, 0.07)]
)
def test_fewer_gaussians_show_the_same_head_from_far(session, lod, size, colors, fog):
    avatar, camera = session.open("default"), Camera.orbit(size, size, yaw=20, distance=1.1, fov=23)
    full, thin = (
        session.render([Instance(avatar.id, hair=BARE)], camera, replace(PLAIN, passes=("rgb", "alpha"), lod=level))
        for level in (0, lod)
    )
    inside = full["alpha"][..., 0] > 0.99
    assert float(np.abs(full["rgb"] - thin["rgb"])[inside].mean()) < colors
    assert float(thin["alpha"][inside].mean()) > 0.99  # no gaps
    assert float((thin["alpha"] - full["alpha"])[~inside].mean()) < fog  # nor much beside the head
