"""A person in glasses: eyes and skin beside them are painted, skin behind lenses and frames is the person's own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from drawn_glasses import with_glasses
from lit_person import lit_person
from photo_parts import parts_of

from grmm_core.avatar import save_avatar
from grmm_core.fitting import photo_targets
from grmm_core.fitting.invert import invert, photo_views
from grmm_core.fitting.photo_light import Light
from grmm_core.fitting.photo_targets import project
from grmm_core.fitting.presets import CodeSettings, DecoderSettings, Preset
from grmm_core.hair import library_groom
from grmm_core.photo.glasses import Glasses
from grmm_core.photo.lenses import EYES
from grmm_core.session import HairUse, Instance, RenderOptions, make_local_session

SIDE = 288
FRAME, TINT, GLEAM = np.array([0.1, 0.25, 0.6]), np.array([0.8, 0.85, 0.75]), 0.5
QUICK = Preset("quick", CodeSettings(64, 64, 1, 1, 0, 2), DecoderSettings(((192, 3),), False))
AROUND = 0.032  # metres around an eye


@pytest.fixture(scope="module")
def session():
    with make_local_session(engine="torch") as session:
        yield session


@pytest.fixture(scope="module")
def worn(session, tmp_path_factory):
    """The default head with and without glasses as exactly tracked photos."""
    loaded = session.engine.store.default()
    head = loaded.model.head_model
    avatar, track = lit_person(session, Light.studio(), library_groom("thin", head.name, "brows"), side=SIDE)
    path = tmp_path_factory.mktemp("worn") / "person.grmm"
    save_avatar(avatar, path)
    number = session.open(path).id
    options = RenderOptions(passes=("rgb", "alpha"), background=(0.5, 0.5, 0.5))
    bare = HairUse("none", brows="none", beard="none", lashes="none")
    drawn = session.render([Instance(number, hair=bare)], track.camera, options)
    marks = project(head.landmark_positions(head.vertices(*(np.zeros(1),) * 2, np.zeros((5, 3))), 478), track.camera)
    image, _, _ = with_glasses(drawn["rgb"], marks, FRAME, TINT, GLEAM)
    plain = dataclasses.replace(
        track, image=drawn["rgb"], mask=drawn["alpha"].reshape(SIDE, SIDE), landmarks=marks, landmarks_fitted=marks
    )  # fmt: skip
    return plain, dataclasses.replace(plain, image=image)


@pytest.fixture(autouse=True)
def all_skin(monkeypatch):
    """Parsed photos show nothing but skin, for the parser does not see such frames either."""
    monkeypatch.setattr(photo_targets, "parse", lambda track, head: parts_of(1.0 - track.mask))


def test_eyes_are_targets_and_what_is_around_them_behind_lenses_is_not(session, worn):
    plain, track = worn
    model = session.engine.store.default().model
    (before,), (view,) = photo_views(model, [plain], SIDE), photo_views(model, [track], SIDE)
    scale = view.camera.fx / track.camera.fx
    corner = np.array([view.camera.cx, view.camera.cy]) - scale * np.array([track.camera.cx, track.camera.cy])

    def at(point):
        column, row = (scale * np.asarray(point) + corner).astype(int)
        return row, column

    for outline in EYES:
        marks = track.landmarks[list(outline)]
        width, middle = np.ptp(marks[:, 0]), marks.mean(0)
        assert view.weight[at(middle)] == 1.0
        below = at(middle + np.array([0.0, 0.3 * width]))
        assert (before.weight[below], view.weight[below], view.lenses[below]) == (1.0, 0.0, 1.0)
        assert view.through_lenses().weight[below] == 1.0
    assert not before.lenses.any()
    assert not (view.through_lenses().weight * before.weight)[at(track.landmarks[6])], "the bridge"
    for mark in (151, 152, 50, 280):  # forehead, chin, cheeks
        assert before.weight[at(track.landmarks[mark])] == view.weight[at(track.landmarks[mark])] == 1.0


def test_around_the_eyes_a_person_in_glasses_comes_nearer_to_the_bare_one(session, worn, monkeypatch):
    """The colors of the fit against those of the person, and against a fit that knows of no glasses."""
    loaded = session.engine.store.default()
    model, head = loaded.model, loaded.model.head_model
    _, track = worn
    corners = head.faces[model.layout.face]
    places = (np.asarray(head.v_template)[corners] * np.asarray(model.layout.barycentric)[..., None]).sum(1)
    skin = (head.marked("face") & ~head.marked("brows", "lids", "lips"))[corners].all(1)
    near = np.zeros_like(skin)
    for side in ("left", "right"):
        eye = np.asarray(head.v_template)[head.regions[f"{side}_eyeball"]].mean(0)
        near |= np.linalg.norm(places - eye, axis=1) < AROUND

    def decoded(z_id):
        with torch.no_grad():
            return model.appearance(torch.as_tensor(np.array(z_id)), torch.tensor([0.0, 0.0, 1.0]))[0].numpy()

    def fitted():
        avatar = invert([dataclasses.replace(track)], model, head, QUICK, info=loaded.info)
        return decoded(avatar.z_id) + avatar.deltas["decoders.appearance_mean"][:, :3]

    truth, known = decoded(loaded.info.default_z_id), fitted()
    monkeypatch.setattr(photo_targets, "worn_glasses", lambda track, parts: Glasses(*(np.zeros(track.mask.shape, bool),) * 2))
    unknown = fitted()
    off = [np.abs(one - truth)[skin & near].mean() for one in (known, unknown)]
    assert off[0] < 0.5 * off[1], off
    assert off[0] < 1.5 * np.abs(known - truth)[skin & ~near].mean(), "as near as skin that is seen"
    blue = [np.quantile((one[:, 2] - one[:, 0])[skin & near], 0.999) for one in (truth, known, unknown)]
    assert blue[1] < blue[0] + 0.06, "nothing of the frames' color is on the skin"
    assert blue[2] > blue[0] + 0.3, "which would be there"
