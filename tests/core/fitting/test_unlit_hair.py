"""A photo's light taken out of its hair."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from photo_parts import parts_of

from grmm_core.avatar import Hair, save_avatar
from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.fitting.hair_light import unlit_hair
from grmm_core.fitting.photo_light import MATT, SUNS, Light
from grmm_core.fitting.result import LIGHT, make_avatar, photo_controls
from grmm_core.fitting.types import LANDMARK_COUNT, PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, library_groom
from grmm_core.session import Instance, RenderOptions, make_local_session

SIDE = 160
GREY = (0.5, 0.5, 0.5)


@pytest.fixture(scope="module")
def session():
    with make_local_session(engine="torch") as session:
        yield session


@pytest.fixture(scope="module")
def side():
    """A strong light from the person's left, and a dim one from everywhere."""
    suns, around = np.zeros((len(SUNS), 3), np.float32), np.zeros((9, 3), np.float32)
    suns[np.argmax([sun.direction[0] for sun in SUNS])] = 6.0
    around[0] = 0.6
    return Light(suns, around, np.full(3, 0.4, np.float32), np.ones(3, np.float32))


def person(session, light, image=None, cover=None):
    """The default head with a bob as one photo shows it, and the photo's track."""
    loaded = session.engine.store.default()
    head = loaded.model.head_model
    plain = np.ones((SIDE, SIDE), np.float32)
    camera, marks = Camera.orbit(SIDE, SIDE, 10.0, 5.0), np.zeros((LANDMARK_COUNT, 2))
    zeros = {"shape": np.zeros(head.shape_count), "expression": np.zeros(head.expression_count), "pose": np.zeros((5, 3))}
    track = PhotoTrack(
        source="", image=np.zeros((SIDE, SIDE, 3)) if image is None else image, mask=plain if cover is None else cover,
        valid=plain, camera=camera, photo_camera=camera, landmarks=marks, landmarks_fitted=marks, arkit=np.zeros(52), **zeros,
    )  # fmt: skip
    tracking = {"aligned": np.zeros((1, len(ALIGNED_NAMES)), np.float32), "z_exp": np.zeros((1, loaded.model.z_exp_size))}
    tracking |= {LIGHT + name: getattr(light, name)[None] for name in Light._fields}
    avatar = make_avatar(
        "lit", [track], loaded.info, loaded.info.default_z_id, np.zeros(loaded.model.z_exp_size, np.float32), {}, tracking
    )
    return dataclasses.replace(avatar, hair=Hair(library_groom("bob"), HairSettings(melanin=0.3))), track, head


def test_hair_lit_from_a_side_is_as_in_the_studio_again(session, side, tmp_path):
    avatar, track, head = person(session, side)
    save_avatar(avatar, tmp_path / "lit.grmm")
    placed = Instance(session.open(tmp_path / "lit.grmm").id, photo_controls(avatar, head))
    options = RenderOptions(refine=False, passes=("rgb", "alpha", "hair"), background=GREY)
    flat = session.render([placed], track.camera, options)
    lit = session.render([dataclasses.replace(placed, response=MATT, lighting=side.lighting)], track.camera, options)
    avatar, track, head = person(session, side, lit["rgb"].astype(np.float64), flat["alpha"][..., 0])
    cover = flat["hair"][..., 0]
    parts = parts_of(1.0 - flat["alpha"][..., 0], hair=cover)
    again, (found,) = unlit_hair(session, avatar, [track], [parts], head)
    full = cover > 0.98
    wrong, left = (np.abs(image - flat["rgb"])[full].mean() for image in (lit["rgb"], found.image))
    assert full.sum() > 1000
    assert wrong > 0.08
    assert left < 0.35 * wrong
    assert abs(again.hair.settings.melanin - 0.3) < 0.1


def test_in_the_studios_light_nothing_is_done(session):
    avatar, track, head = person(session, Light.studio())
    same, tracks = unlit_hair(session, avatar, [track], [parts_of(np.zeros((SIDE, SIDE)))], head)
    assert same is avatar
    assert tracks[0] is track
