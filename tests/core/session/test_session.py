"""Sessions: the in-process and the worker implementation pass the same tests."""

from __future__ import annotations

import dataclasses
import os
import threading

import numpy as np
import pytest

from grmm_core.avatar import load_avatar, save_avatar
from grmm_core.controls.frame import Controls
from grmm_core.errors import (
    CancelledError,
    ConfigError,
    ControlError,
    FileAccessError,
    FileFormatError,
    SessionError,
    ShapeError,
)
from grmm_core.geometry.camera import Camera
from grmm_core.session import EMPTY_DEPTH, PASS_NAMES, Instance, RenderOptions, Session, create_session

SIZE = 96
CAMERA = Camera.orbit(SIZE, SIZE)
FLOAT = {"rtol": 1e-5, "atol": 1e-5}  # another order of additions
MOVED = {"rtol": 0.0, "atol": 5e-3}  # other roundings of positions: a splat may cross the cut-off of 1/255 at a pixel


def moved(x=0.0, y=0.0, z=0.0, scale=1.0) -> np.ndarray:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


@pytest.fixture(scope="module")
def worker(weights):
    with create_session("worker", weights=weights, device="cpu", threads=1, engine="torch") as session:
        yield session


@pytest.fixture(scope="module")
def plain(weights):
    with create_session("local", weights=weights, device="cpu", threads=1, engine="plain") as session:
        yield session


@pytest.fixture(scope="module")
def plain_worker(weights):
    with create_session("worker", weights=weights, device="cpu", threads=1, engine="plain") as session:
        yield session


@pytest.fixture(scope="module", params=["local", "worker", "plain", "plain_worker"])
def session(request):
    session = request.getfixturevalue(request.param)
    assert session.open("default").id
    assert session.status().engine == ("plain" if request.param.startswith("plain") else "torch")
    return session


@pytest.fixture
def avatar(session):
    return session.open("default")


def all_passes(session, instances, camera=CAMERA, **options):
    return session.render(instances, camera, RenderOptions(passes=PASS_NAMES, **options))


def test_both_are_sessions(session):
    assert isinstance(session, Session)


def test_open_tells_what_the_avatar_is(session, avatar):
    assert (avatar.source, avatar.weights_name, avatar.head_name) == ("default", "tiny", "open_head")
    assert len(avatar.weights_sha256) == 64
    assert avatar.z_id.shape == (avatar.z_id_size,)
    assert avatar.shape.shape == (300,)
    assert avatar.aligned_code_norms.shape == (60,)
    assert (avatar.aligned_code_norms > 0).all()
    assert avatar.provenance["licence"] == "CC0-1.0"
    assert session.open("default").id == avatar.id


def test_deform_is_the_head_model_with_the_displacement(session, avatar):
    from grmm_core.head import load_open_head

    head = load_open_head()
    controls = Controls().set_named({"jawOpen": 0.7, "neck.y": 0.2, "shape.3": 1.5, "expression.60": 0.4})
    mesh = session.deform(avatar.id, controls)
    assert mesh.vertices.shape == mesh.displacement.shape == (avatar.vertex_count, 3)
    expression = np.zeros(head.expression_count, np.float32)
    expression[[head.expression_index("jawOpen"), 60]] = 0.7, 0.4
    shape = avatar.shape + np.eye(300, dtype=np.float32)[3] * 1.5
    expected = head.vertices(shape, expression, head.pose_of(expression, controls.pose), mesh.displacement)
    np.testing.assert_allclose(mesh.vertices, expected, rtol=0, atol=2e-6)
    assert np.abs(mesh.displacement).max() > 1e-5
    assert mesh.joints.shape == (5, 3)
    # the neck turns about its own joint, which stays where it is
    np.testing.assert_allclose(mesh.joints[1], head.joints(shape)[1], atol=1e-6)


def test_residual_strength_scales_the_displacement(session, avatar):
    none = session.deform(avatar.id, dataclasses.replace(Controls(), residual_strength=0.0))
    full = session.deform(avatar.id, Controls())
    np.testing.assert_array_equal(none.displacement, 0.0)
    assert np.abs(full.displacement).max() > 0


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"aligned": np.full(60, np.nan)}, ControlError, "browDownLeft is not a finite number"),
        ({"pose": np.full((5, 3), np.inf)}, ControlError, r"root\.x is not a finite number"),
        ({"aligned": np.zeros(3)}, ShapeError, "aligned has shape"),
        ({"z_id": np.zeros(200)}, ShapeError, "z_id has 200 values; this model takes 6"),
    ],
)
def test_bad_controls_are_named(session, avatar, change, error, message):
    controls = Controls(**change)
    with pytest.raises(error, match=message):
        session.deform(avatar.id, controls)
    with pytest.raises(error, match=message):
        session.render([Instance(avatar.id, controls)], CAMERA)


def test_unknown_avatars_are_named(session):
    for call in (
        lambda: session.deform(999, Controls()),
        lambda: session.gaussians(999, Controls()),
        lambda: session.render([Instance(999)], CAMERA),
        lambda: session.save(999, "x.grmm"),
    ):
        with pytest.raises(SessionError, match="no avatar 999"):
            call()
    session.release(999)


def test_passes_have_their_documented_form(session, avatar):
    passes = all_passes(session, [Instance(avatar.id)])
    channels = {"rgb": 3, "alpha": 1, "depth": 1, "raw": 3, "normal": 3, "features": avatar.feature_count, "mask": 1}
    channels |= {"hair": 1, "diffuse": 3, "specular": 3, "shadow": 1}
    assert {name: buffer.shape for name, buffer in passes.items()} == {n: (SIZE, SIZE, c) for n, c in channels.items()}
    assert {buffer.dtype for buffer in passes.values()} == {np.dtype(np.float32)}
    alpha, depth = passes["alpha"], passes["depth"]
    assert alpha.min() >= 0
    assert alpha.max() > 0.9
    assert alpha[0, 0] == 0
    assert depth[0, 0] == EMPTY_DEPTH
    assert np.abs(depth[alpha > 0.5] - 1.0).max() < 0.3  # metres: the head is around the origin, the camera 1 m away
    lengths = np.linalg.norm(passes["normal"], axis=-1)
    np.testing.assert_allclose(lengths[alpha[..., 0] > 0.1], 1.0, atol=1e-5)
    assert passes["normal"][alpha[..., 0] > 0.9][:, 2].mean() > 0.3  # towards the camera
    np.testing.assert_array_equal(passes["mask"], alpha)
    assert (passes["rgb"][alpha[..., 0] == 0] == 0).all()


def test_passes_do_not_depend_on_their_company(session, avatar):
    together = all_passes(session, [Instance(avatar.id)])
    for name in PASS_NAMES:
        alone = session.render([Instance(avatar.id)], CAMERA, RenderOptions(passes=(name,)))
        assert list(alone) == [name]
        np.testing.assert_allclose(alone[name], together[name], **FLOAT)


def test_refinement_can_be_left_out(session, avatar):
    refined = all_passes(session, [Instance(avatar.id)])
    plain = all_passes(session, [Instance(avatar.id)], refine=False)
    np.testing.assert_array_equal(plain["rgb"], plain["raw"])
    np.testing.assert_allclose(plain["raw"], refined["raw"], **FLOAT)
    assert np.abs(refined["rgb"] - refined["raw"]).max() > 0.01


@pytest.mark.parametrize(("width", "height"), [(64, 64), (51, 37), (1, 1)])
def test_coarse_refinement_is_for_previews(session, avatar, width, height):
    camera = Camera.orbit(width, height)
    fine = session.render([Instance(avatar.id)], camera, RenderOptions(passes=("rgb", "alpha", "raw")))
    coarse = session.render([Instance(avatar.id)], camera, RenderOptions(passes=("rgb", "alpha", "raw"), coarse=True))
    np.testing.assert_array_equal(coarse["alpha"], fine["alpha"])
    np.testing.assert_array_equal(coarse["raw"], fine["raw"])
    empty = coarse["alpha"][..., 0] == 0
    assert (coarse["rgb"][empty] == 0).all()
    assert np.isfinite(coarse["rgb"]).all()
    if width > 1:
        assert np.abs(coarse["rgb"] - coarse["raw"]).max() > 0.01


def test_background_is_put_behind(session, avatar):
    color = (0.2, 0.5, 0.9)
    over = all_passes(session, [Instance(avatar.id)], background=color)
    bare = all_passes(session, [Instance(avatar.id)])
    for name in ("rgb", "raw"):
        np.testing.assert_allclose(over[name], bare[name] + (1 - bare["alpha"]) * np.float32(color), atol=1e-6)
    np.testing.assert_array_equal(over["alpha"], bare["alpha"])


def test_controls_change_the_picture(session, avatar):
    neutral = session.render([Instance(avatar.id)], CAMERA)["rgb"]
    turned = session.render([Instance(avatar.id, Controls().set_named({"neck.y": 0.5}))], CAMERA)["rgb"]
    other = session.render([Instance(avatar.id, Controls().set_named({"z_id.0": 3.0}))], CAMERA)["rgb"]
    assert np.abs(turned - neutral).max() > 0.1
    assert np.abs(other - neutral).max() > 0.01
    np.testing.assert_allclose(session.render([Instance(avatar.id)], CAMERA)["rgb"], neutral, atol=1e-5)


def test_placement_moves_the_avatar_and_not_the_picture(session, avatar):
    """An avatar and a camera moved, turned and enlarged together give the same picture."""
    at_home = all_passes(session, [Instance(avatar.id)])
    turn = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    placement = moved(30.0, -20.0, 50.0) @ turn @ moved(scale=2.0)
    rigid = moved(30.0, -20.0, 50.0) @ turn
    world_to_camera = CAMERA.world_to_camera.copy()
    world_to_camera[:3, 3] *= 2.0
    camera = dataclasses.replace(CAMERA, world_to_camera=world_to_camera @ np.linalg.inv(rigid))
    away = all_passes(session, [Instance(avatar.id, model_to_world=placement)], camera)
    for name in ("rgb", "raw", "alpha", "features", "mask"):
        np.testing.assert_allclose(away[name], at_home[name], **MOVED)
    covered = at_home["alpha"][..., 0] > 0.5
    np.testing.assert_allclose(away["depth"][covered], 2.0 * at_home["depth"][covered], rtol=1e-4)
    np.testing.assert_allclose(away["normal"][covered], at_home["normal"][covered] @ turn[:3, :3].T, atol=2e-3)


def test_orthographic_cameras_work(session, avatar):
    camera = dataclasses.replace(CAMERA, fx=250.0, fy=250.0, orthographic=True)
    passes = all_passes(session, [Instance(avatar.id)], camera)
    assert passes["alpha"].max() > 0.9
    assert np.isfinite(passes["rgb"]).all()


def test_avatars_occlude_one_another(session, avatar):
    front = Instance(avatar.id, model_to_world=moved(z=0.3))
    back = Instance(avatar.id, model_to_world=moved(z=-0.3))
    alone = all_passes(session, [front])
    for order in ([front, back], [back, front]):
        both = all_passes(session, order)
        covers = {id(item): both["mask"][..., k] for k, item in enumerate(order)}
        np.testing.assert_allclose(both["mask"].sum(-1, keepdims=True), both["alpha"], atol=1e-5)
        solid = alone["alpha"][..., 0] > 0.998
        assert solid.any()
        assert covers[id(back)][solid].max() < 0.01
        np.testing.assert_allclose(covers[id(front)], alone["alpha"][..., 0], **MOVED)
        np.testing.assert_allclose(both["raw"][solid], alone["raw"][solid], atol=0.01)


def test_avatars_side_by_side_look_as_they_do_alone(session, avatar):
    """Refinement too: each avatar's depth is normalised over itself, wherever the others are."""
    wide = Camera.orbit(3 * SIZE, SIZE)
    left = Instance(avatar.id, model_to_world=moved(-0.35))
    right = Instance(avatar.id, Controls().set_named({"jawOpen": 0.5}), moved(0.35, z=-0.2))
    both = all_passes(session, [left, right], wide)
    for k, item in enumerate((left, right)):
        alone = all_passes(session, [item], wide)
        # what the networks of the two see must not overlap: compare around the middle of each
        columns = slice(0, 110) if k == 0 else slice(180, 3 * SIZE)
        np.testing.assert_allclose(both["rgb"][:, columns], alone["rgb"][:, columns], **MOVED)
        np.testing.assert_allclose(both["mask"][:, columns, k], alone["alpha"][:, columns, 0], **MOVED)


def test_no_avatars_give_an_empty_picture(session):
    passes = all_passes(session, [], background=(0.1, 0.2, 0.3))
    assert (passes["depth"] == EMPTY_DEPTH).all()
    assert not passes["alpha"].any()
    np.testing.assert_allclose(passes["rgb"][0, 0], [0.1, 0.2, 0.3])
    assert passes["mask"].shape == (SIZE, SIZE, 0)


def test_an_avatar_behind_the_camera_gives_an_empty_picture(session, avatar):
    passes = all_passes(session, [Instance(avatar.id, model_to_world=moved(z=5.0))])
    assert not passes["alpha"].any()
    assert not passes["rgb"].any()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 33), (130, 50)])
def test_odd_picture_sizes(session, avatar, width, height):
    passes = all_passes(session, [Instance(avatar.id)], Camera.orbit(width, height))
    assert passes["rgb"].shape == (height, width, 3)
    assert np.isfinite(passes["rgb"]).all()


def test_less_detail_keeps_the_head_whole(session, avatar):
    full = session.gaussians(avatar.id, Controls())
    coarse = session.gaussians(avatar.id, Controls(), lod=1)
    assert 0.2 < len(coarse.means) / len(full.means) < 0.45
    options = [RenderOptions(passes=("alpha",), lod=lod) for lod in (0, 1)]
    pictures = [session.render([Instance(avatar.id)], CAMERA, option)["alpha"] for option in options]
    full_cover, coarse_cover = (picture > 0.5 for picture in pictures)
    assert (full_cover & coarse_cover).sum() / (full_cover | coarse_cover).sum() > 0.8


def test_gaussians_draw_the_raw_picture(session, avatar):
    """What `gaussians` returns is what `render` draws: rasterised here by the readable reference."""
    import torch

    from grmm_core.splat import Gaussians, rasterize

    controls = Controls().set_named({"jawOpen": 0.4})
    found = session.gaussians(avatar.id, controls, CAMERA.view_direction(np.zeros(3)), features=True)
    assert found.features.shape == (avatar.gaussian_count, avatar.feature_count)
    parts = [torch.from_numpy(array) for array in found]
    drawn = rasterize(Gaussians(*parts), CAMERA, backend="torch")
    passes = all_passes(session, [Instance(avatar.id, controls)])
    np.testing.assert_allclose(passes["raw"], drawn.rgb.numpy(), **MOVED)
    np.testing.assert_allclose(passes["features"], drawn.features.numpy(), **MOVED)


def test_view_directions_are_checked(session, avatar):
    with pytest.raises(ShapeError, match="unit vector"):
        session.gaussians(avatar.id, Controls(), np.zeros(3))


def test_samples_follow_their_seed(session):
    first, again, other = session.sample(3), session.sample(3), session.sample(4)
    assert first.id == again.id != other.id
    assert first.source == "sample:3"
    assert session.open(first.source).id == first.id
    assert np.abs(first.z_id - other.z_id).max() > 0.1
    assert np.abs(first.shape).max() > 0
    assert not first.provenance["from_photos"]


def test_saved_avatars_open_again(session, tmp_path):
    path = tmp_path / "Ünï.grmm"
    made = session.sample(11)
    session.save(made.id, path)
    opened = session.open(path)
    assert opened.id != made.id
    assert opened.name == made.name == "Sample 11"
    assert opened.thumbnail.startswith(b"\x89PNG")
    painting = load_avatar(path).painting
    assert painting.shape == (256, 256, 3)
    assert painting.std() > 1
    np.testing.assert_array_equal(opened.z_id, made.z_id)
    np.testing.assert_array_equal(session.deform(opened.id, Controls()).vertices, session.deform(made.id, Controls()).vertices)
    assert session.open(os.fspath(path)).id == opened.id
    session.save(session.sample(12).id, path)  # another person under the same name
    assert session.open(path).name == "Sample 12"


def test_saving_into_a_missing_folder_says_so(session, avatar, tmp_path):
    with pytest.raises(FileAccessError, match="Cannot write"):
        session.save(avatar.id, tmp_path / "none" / "x.grmm")


def test_files_that_cannot_be_opened(session, tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        session.open(tmp_path / "missing.grmm")
    path = tmp_path / "x.grmm"
    session.save(session.sample(1).id, path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(FileFormatError, match="not a readable"):
        session.open(path)


def test_avatars_of_other_weights_are_refused(session, tmp_path):
    path = tmp_path / "x.grmm"
    session.save(session.sample(1).id, path)
    avatar = load_avatar(path).with_pictures(b"", np.zeros((0, 0, 3), np.uint8))  # a painting would be carried over
    save_avatar(dataclasses.replace(avatar, weights=dataclasses.replace(avatar.weights, sha256="f" * 64)), path)
    with pytest.raises(FileFormatError, match=r"needs the trained weights 'tiny' .*not installed"):
        session.open(path)
    save_avatar(dataclasses.replace(avatar, head=dataclasses.replace(avatar.head, sha256="f" * 64)), path)
    with pytest.raises(FileFormatError, match="another version of the head model"):
        session.open(path)
    save_avatar(dataclasses.replace(avatar, z_id=np.zeros(9)), path)
    with pytest.raises(FileFormatError, match="do not fit the weights"):
        session.open(path)
    save_avatar(dataclasses.replace(avatar, deltas={"nonsense": np.zeros(3)}), path)
    with pytest.raises(FileFormatError, match="parameter 'nonsense'"):
        session.open(path)


def test_weight_changes_belong_to_their_avatar(session, tmp_path):
    base, person = session.open("default"), session.sample(1)
    path = tmp_path / "changed.grmm"
    session.save(person.id, path)
    avatar = load_avatar(path)
    before = {a: session.render([Instance(a)], CAMERA)["rgb"] for a in (base.id, person.id)}
    save_avatar(dataclasses.replace(avatar, deltas={"refinement.exit.bias": np.full(12, 0.3, np.float32)}), path)
    changed = session.open(path)
    brighter = session.render([Instance(changed.id)], CAMERA)
    np.testing.assert_allclose(brighter["rgb"], before[person.id] + 0.3 * brighter["alpha"], atol=1e-4)
    for avatar_id, picture in before.items():
        np.testing.assert_allclose(session.render([Instance(avatar_id)], CAMERA)["rgb"], picture, atol=1e-5)
    # different networks in one picture: each changes its own avatar
    wide = Camera.orbit(3 * SIZE, SIZE)
    pair = [Instance(person.id, model_to_world=moved(-0.35)), Instance(changed.id, model_to_world=moved(0.35))]
    both = session.render(pair, wide)["rgb"]
    for item, columns in zip(pair, (slice(0, 110), slice(180, 3 * SIZE)), strict=True):
        alone = session.render([item], wide)["rgb"]
        np.testing.assert_allclose(both[:, columns], alone[:, columns], **MOVED)


def test_cancelled_pictures_leave_the_session_usable(session, avatar):
    with pytest.raises(CancelledError):
        session.render([Instance(avatar.id)], CAMERA, should_cancel=lambda: True)
    asked = []
    passes = session.render([Instance(avatar.id)], CAMERA, should_cancel=lambda: bool(asked.append(1)))
    assert passes["alpha"].max() > 0.9
    assert asked


def test_large_pictures_are_refused_and_unknown_passes_named(session, avatar):
    with pytest.raises(ConfigError, match="100000x100000 pixels is too large"):
        session.render([Instance(avatar.id)], Camera.orbit(100_000, 100_000))
    with pytest.raises(ConfigError, match="no render pass 'beauty'"):
        RenderOptions(passes=("beauty",))
    with pytest.raises(ShapeError, match="one uniform positive scale"):
        Instance(avatar.id, model_to_world=np.diag([1.0, 2.0, 1.0, 1.0]))


def test_released_avatars_are_gone(session):
    info = session.sample(77)
    session.deform(info.id, Controls())
    session.release(info.id)
    with pytest.raises(SessionError, match="open it first"):
        session.deform(info.id, Controls())
    assert session.sample(77).id != info.id


def test_status_tells_what_runs_the_model(session, avatar):
    session.deform(avatar.id, Controls())
    status = session.status()
    assert status.alive
    assert status.device == "cpu"
    assert status.threads == 1
    assert status.engine in ("torch", "plain")
    assert bool(status.torch) == (status.engine == "torch")
    assert status.pid > 0
    assert (status.pid == os.getpid()) == (status.kind == "local")


@pytest.mark.parametrize("mode", ["local", "worker"])
def test_closed_sessions_say_so(mode, weights):
    session = create_session(mode, weights=weights)
    session.close()
    session.close()
    with pytest.raises(SessionError, match="closed"):
        session.open("default")
    assert not session.status().alive


@pytest.mark.parametrize("mode", ["local", "worker"])
def test_missing_weights_are_named(mode, tmp_path):
    path = tmp_path / "none.safetensors"
    with create_session(mode, weights=path) as session, pytest.raises(FileAccessError, match="not installed"):
        session.open("default")


def test_both_draw_the_same(local, worker):
    controls = Controls().set_named({"mouthSmileLeft": 1.0, "eyes.yaw": 0.3})
    pictures = [all_passes(s, [Instance(s.open("default").id, controls)]) for s in (local, worker)]
    for name in PASS_NAMES:
        np.testing.assert_allclose(pictures[0][name], pictures[1][name], rtol=0, atol=0)


def test_who_cannot_wait_is_told_whether_calls_are_carried_out_at_once(session, avatar):
    session.deform(avatar.id, Controls())
    with session.at_once(0.0) as free:
        assert free
        session.deform(avatar.id, Controls())
    holding, done = threading.Event(), threading.Event()

    def hold():
        with session.at_once(60.0):
            holding.set()
            done.wait(60.0)

    thread = threading.Thread(target=hold)
    thread.start()
    try:
        assert holding.wait(60.0)
        with session.at_once(0.05) as free:
            assert not free
    finally:
        done.set()
        thread.join()
    with session.at_once(60.0) as free:
        assert free
