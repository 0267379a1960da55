"""A photo's light taken out of its hair."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lit_person import SIDE, light_from_a_side, lit_person
from photo_parts import parts_of

from grmm_core.avatar import save_avatar
from grmm_core.fitting.hair_light import unlit_hair
from grmm_core.fitting.photo_light import MATT, Light
from grmm_core.fitting.result import photo_controls
from grmm_core.hair import library_groom
from grmm_core.session import Instance, RenderOptions, make_local_session

GREY = (0.5, 0.5, 0.5)


@pytest.fixture(scope="module")
def session():
    with make_local_session(engine="torch") as session:
        yield session


@pytest.fixture(scope="module")
def side():
    return light_from_a_side()


def person(session, light, *photo):
    """See `lit_person`, in a bob; and the head."""
    return *lit_person(session, light, library_groom("bob"), *photo), session.engine.store.default().model.head_model


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
    assert abs(again.settings.melanin - 0.3) < 0.1


def test_in_the_studios_light_nothing_is_done(session):
    avatar, track, head = person(session, Light.studio())
    same, tracks = unlit_hair(session, avatar, [track], [parts_of(np.zeros((SIDE, SIDE)))], head)
    assert same is avatar.hair
    assert tracks[0] is track
