"""A person in a photo whose light is known, for tests of what the end of a fit does."""

from __future__ import annotations

import dataclasses

import numpy as np

from grmm_core.avatar import Avatar, Hair
from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.fitting.photo_light import SUNS, Light
from grmm_core.fitting.result import LIGHT, make_avatar
from grmm_core.fitting.types import LANDMARK_COUNT, PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings
from grmm_core.hair.groom import Groom

SIDE = 160


def light_from_a_side() -> Light:
    """A strong light from the person's left, and a dim one from everywhere."""
    suns, around = np.zeros((len(SUNS), 3), np.float32), np.zeros((9, 3), np.float32)
    suns[np.argmax([sun.direction[0] for sun in SUNS])] = 6.0
    around[0] = 0.6
    return Light(suns, around, np.full(3, 0.4, np.float32), np.ones(3, np.float32))


def lit_person(session, light: Light, groom: Groom, image=None, cover=None, side=SIDE) -> tuple[Avatar, PhotoTrack]:
    """The default head with a groom as one photo shows it, and the photo's track."""
    loaded = session.engine.store.default()
    head = loaded.model.head_model
    plain = np.ones((side, side), np.float32)
    camera, marks = Camera.orbit(side, side, 10.0, 5.0), np.zeros((LANDMARK_COUNT, 2))
    zeros = {"shape": np.zeros(head.shape_count), "expression": np.zeros(head.expression_count), "pose": np.zeros((5, 3))}
    track = PhotoTrack(
        source="", image=np.zeros((side, side, 3)) if image is None else image, mask=plain if cover is None else cover,
        valid=plain, camera=camera, photo_camera=camera, landmarks=marks, landmarks_fitted=marks, arkit=np.zeros(52), **zeros,
    )  # fmt: skip
    tracking = {"aligned": np.zeros((1, len(ALIGNED_NAMES)), np.float32), "z_exp": np.zeros((1, loaded.model.z_exp_size))}
    tracking |= {LIGHT + name: value[None] for name, value in light._asdict().items() if value.size}
    z_exp = np.zeros(loaded.model.z_exp_size, np.float32)
    avatar = make_avatar("lit", [track], loaded.info, loaded.info.default_z_id, z_exp, {}, tracking)
    return dataclasses.replace(avatar, hair=Hair(groom, HairSettings(melanin=0.3))), track
