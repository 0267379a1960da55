"""Weights trained on a FLAME head, in both sessions: the user names the FLAME file, and gets one sentence without it."""

from __future__ import annotations

import numpy as np
import pytest
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields
from tiny_model import write_tiny_weights

from grmm_core.controls.frame import Controls
from grmm_core.errors import FileFormatError, ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.head import load_flame
from grmm_core.light.lamps import Lighting, Sun
from grmm_core.light.shading import Response
from grmm_core.session import HairUse, Instance, RenderOptions, create_session, make_local_session


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flame")
    flame = folder / "flame2023.pkl"
    write_flame_pickle(flame, flame_head_fields())
    return flame, write_tiny_weights(folder / "on_flame.safetensors", head=load_flame(flame))


@pytest.mark.parametrize(("mode", "engine"), [("local", "torch"), ("worker", "plain")])
def test_weights_of_a_flame_head(files, mode, engine):
    flame, weights = files
    with create_session(mode, weights=weights, head=flame, engine=engine) as session:
        info = session.open("default")
        head = load_flame(flame)
        assert (info.head_name, info.vertex_count) == (head.name, len(head.v_template))
        mesh = session.deform(info.id, Controls().set_named({"jawOpen": 0.5}))
        rest = session.deform(info.id, Controls())
        assert np.abs(mesh.vertices - rest.vertices).max() > 0.005
        alpha = session.render([Instance(info.id)], Camera.orbit(48, 48), RenderOptions(passes=("alpha",)))["alpha"]
        assert alpha.max() > 0.5


def test_a_flame_head_without_hair_is_drawn_and_a_groom_of_another_head_is_refused(files, tmp_path):
    flame, _ = files
    weights = write_tiny_weights(tmp_path / "bare.safetensors", head=load_flame(flame), hairless=True)
    with make_local_session(weights, "cpu", 1, flame, "plain") as session:
        head, options = session.open("default").id, RenderOptions(passes=("alpha",))
        assert session.render([Instance(head)], Camera.orbit(48, 48), options)["alpha"].max() > 0.5
        with pytest.raises(ShapeError, match="bob is for the head open_head, not flame2023; wear it on an avatar of that head"):
            session.render([Instance(head, hair=HairUse("groom:bob"))], Camera.orbit(48, 48), options)


@pytest.mark.parametrize("engine", ["plain", "torch"])
def test_a_flame_head_is_lit_with_an_open_jaw_and_a_turned_neck(files, engine):
    with make_local_session(files[1], "cpu", 1, files[0], engine) as session:
        head = Instance(session.open("default").id, Controls().set_named({"jawOpen": 0.7, "neck.y": 0.5}), response=Response())
        sides = []
        for x in (1.0, -1.0):
            options = RenderOptions(lighting=Lighting((Sun(direction=(x, 0.0, 0.0), strength=3.0),)))
            picture = session.render([head], Camera.orbit(48, 48), options)["rgb"]
            assert np.isfinite(picture).all()
            sides.append(picture)
        left, right = ((sides[0] - sides[1])[:, part].mean() for part in (slice(24, None), slice(24)))
        assert left > 0.02 > -0.02 > right  # the subject's left is on the right


def test_weights_of_a_flame_head_without_the_file(files):
    with create_session("local", weights=files[1]) as session, pytest.raises(FileFormatError, match="--head"):
        session.open("default")
