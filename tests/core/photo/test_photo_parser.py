"""The photo parser on the two portraits of the repository, against masks drawn by hand, and what it promises."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch

from grmm_core.controls.frame import Controls
from grmm_core.errors import FileFormatError
from grmm_core.fitting.photo_targets import left_out
from grmm_core.fitting.track import frame_of, track_photos
from grmm_core.head.open_head import load_open_head
from grmm_core.light.parse import lighting_of
from grmm_core.light.shading import Response
from grmm_core.model.portrait import portrait_camera
from grmm_core.photo import parser, parser_network
from grmm_core.photo.glasses import worn_glasses
from grmm_core.photo.parser import LABELS, MESH_PARTS, bridged, face_parts, mesh_channels, parse
from grmm_core.pictures.images import quantize, write_png
from grmm_core.session import HairUse, Instance, RenderOptions, create_session

HASHES = {"astronaut": "370adb9cb9dd03ca#0", "admiral": "fd98d05804ffd964#0"}


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def tracks(head, repository):
    return {name: track_photos([repository / "tests" / "data" / "photos" / f"{name}.jpg"], head)[0] for name in HASHES}


def overlaps_of(name, tracks, head, repository):
    checking = pytest.importorskip("tools.photo_parser.checking")
    drawn = json.loads((repository / "tests" / "data" / "photo_parts.json").read_text())[HASHES[name]]
    track = tracks[name]
    return checking.overlaps(parse(track, head), checking.painted(drawn, track), track.valid > 0.5)


def test_parts_cover_each_pixel_once(tracks, head):
    parts = parse(tracks["astronaut"], head)
    planes = np.stack([getattr(parts, name) for name in LABELS])
    assert planes.shape == (len(LABELS), 512, 512)
    assert planes.dtype == np.float32
    assert planes.min() >= 0.0
    np.testing.assert_allclose(planes.sum(0), 1.0, atol=1e-4)
    assert parse(tracks["astronaut"], head) is parts, "a fit asks again at every resolution"


@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("astronaut", {"background": 0.9, "face": 0.8, "hair": 0.75, "clothes": 0.7}),
        ("admiral", {"background": 0.9, "face": 0.8, "clothes": 0.8, "hat": 0.6}),
    ],
)
def test_portraits_are_labeled_as_drawn_by_hand(name, least, tracks, head, repository):
    found = overlaps_of(name, tracks, head, repository)
    assert {group for group, share in least.items() if found[group] < share} == set(), found


@pytest.fixture(scope="module")
def bearded(head, tmp_path_factory):
    """A photo of a man of the library beside a window, and where his beard is in it, [H, W] 0..1."""
    path, camera = tmp_path_factory.mktemp("bearded") / "man.png", portrait_camera(512, 8.0)
    light = lighting_of(("lamp:-60,20,60", "world:0.25"))
    with create_session("local", threads=2) as session:
        man = session.open("library:beard").id

        def shot(hair, **more):
            options = RenderOptions(passes=("rgb", "hair"), background=(0.4, 0.43, 0.45), lighting=light)
            return session.render([Instance(man, Controls(), hair=hair, response=Response())], camera, options)

        write_png(path, quantize(shot(HairUse())["rgb"]))
        beard = shot(HairUse("none", brows="none", lashes="none"))["hair"][..., 0]
    return track_photos([path], head)[0], beard


def test_a_beard_is_one_beside_a_window_too_and_chins_have_none(bearded, tracks, head):
    track, beard = bearded
    parts = parse(track, head)
    left, top, side = frame_of(track.photo_camera)
    pixels = (np.arange(track.image.shape[0]) + 0.5) / track.image.shape[0] * side
    row, column = (np.clip(start + pixels, 0, 511).astype(int) for start in (top, left))
    there, found = beard[np.ix_(row, column)] > 0.5, parts.beard > 0.5
    assert (there & found).sum() > 0.5 * (there | found).sum()
    assert parts.other[there].mean() < 0.1, "no thing before the face"
    for name in tracks:
        chin = parse(tracks[name], head).beard[tuple(tracks[name].landmarks[[152, 18, 164], 1::-1].astype(int).T)]
        assert chin.max() < 0.3, name


@pytest.mark.parametrize(("share", "is_one"), [(0.5, False), (0.7, True)])
def test_what_may_be_a_beard_is_skin_unless_the_chin_surely_has_one(share, is_one, tracks, head, monkeypatch):
    def network(pixels):
        shares = torch.full((1, len(LABELS), *pixels.shape[2:]), 1e-6)
        shares[:, LABELS.index("beard")], shares[:, LABELS.index("skin")] = share, 1.0 - share
        return shares.log()

    monkeypatch.setattr(parser, "load_parser", lambda *_: network)
    track = dataclasses.replace(tracks["astronaut"])
    chin = tuple(track.landmarks[[152, 18], 1::-1].astype(int).T)
    parts = parse(track, head)
    assert np.all((parts.beard[chin] > 0.5) == is_one)
    assert np.all((parts.skin[chin] > 0.5) != is_one)


def test_dark_sockets_are_no_glasses_but_lenses_with_a_bridge_are(tracks, head):
    track = tracks["astronaut"]
    marks = track.landmarks
    outer = float(np.linalg.norm(marks[263] - marks[33]))
    rows, columns = np.mgrid[: track.image.shape[0], : track.image.shape[1]] + 0.5
    lenses = np.zeros(rows.shape, bool)
    for corners in ((33, 133), (362, 263)):
        x, y = marks[list(corners)].mean(0)
        lenses |= ((columns - x) / (0.24 * outer)) ** 2 + ((rows - y) / (0.2 * outer)) ** 2 < 1.0
    inner = marks[[133, 362]]
    bridge = (columns > inner[:, 0].min()) & (columns < inner[:, 0].max())
    bridge &= np.abs(rows - inner[:, 1].mean() + 0.06 * outer) < 0.03 * outer

    def worn(dark):
        return parse(dataclasses.replace(track, image=np.where(dark[..., None], np.float32(0.07), track.image)), head).glasses

    assert (worn(lenses | bridge) > 0.5).sum() > 0.7 * lenses.sum()
    mesh = mesh_channels(head, head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose)),
                         track.camera.resized(128, 128))  # fmt: skip
    eyes = mesh[0] > 0.5
    sockets = np.zeros_like(mesh[0])
    across = np.abs(mesh[-1][eyes]).mean()
    sockets[(np.abs(np.abs(mesh[-1]) - across) < 0.4 * across) & (np.abs(mesh[-2] - mesh[-2][eyes].mean()) < 0.4 * across)] = (
        0.8
    )
    assert not bridged(sockets, mesh)
    bar = np.abs(mesh[-2] - mesh[-2][eyes].mean()) < 0.1 * across
    assert bridged(np.where(bar, 0.8, sockets), mesh)
    shut = mesh.copy()
    shut[0] = 0.0
    assert not bridged(sockets, shut), "dark lids of closed eyes"
    assert bridged(np.where(bar, 0.8, sockets), shut)


def test_made_up_eyes_are_no_glasses(tracks, head):
    track = tracks["astronaut"]
    marks, (height, width) = track.landmarks, track.image.shape[:2]
    outer = float(np.linalg.norm(marks[263] - marks[33]))
    rows, columns = np.mgrid[:height, :width] + 0.5
    shade = np.ones((height, width, 1), np.float32)
    for corners in ((33, 133), (362, 263)):
        x, y = marks[list(corners)].mean(0) - [0.0, 0.03 * outer]
        away = ((columns - x) / (0.22 * outer)) ** 2 + ((rows - y) / (0.12 * outer)) ** 2
        shade[..., 0] *= 1.0 - 0.6 * np.exp(-(away**1.5))
    made_up = dataclasses.replace(track, image=(track.image * shade).astype(np.float32))
    assert not worn_glasses(made_up, parse(made_up, head)).covered.any()


def test_a_board_before_half_a_face_is_a_thing_with_all_of_its_color(tracks, head):
    track = tracks["astronaut"]
    before = parse(track, head)
    board = np.zeros(track.image.shape[:2], bool)
    x, top, chin = (int(value) for value in (*track.landmarks[1, :1], *track.landmarks[[10, 152], 1]))
    board[top - (chin - top) // 3 : chin, x : x + (chin - top)] = True
    image = np.where(board[..., None], np.float32([0.28, 0.44, 0.64]), track.image)
    after = parse(dataclasses.replace(track, image=image), head)
    hidden = board & (before.skin + before.hair > 0.9)
    assert hidden.sum() > 3000
    assert after.other[hidden].mean() > 0.9
    assert after.hair[hidden].mean() < 0.05
    assert after.other[~board & (before.skin > 0.9)].mean() < 0.05


@pytest.mark.parametrize(("painted", "is_thing"), [(((33, 133), (61, 291)), True), (((33, 133), (263, 362), (61, 291)), False)])
def test_what_would_take_both_eyes_and_the_mouth_by_its_color_is_no_thing(painted, is_thing, tracks, head, monkeypatch):
    track = tracks["astronaut"]
    rows, columns = np.mgrid[: track.image.shape[0], : track.image.shape[1]]

    def discs(eyes, mouth, below=0):
        middles = [(track.landmarks[list(corners), :2].mean(0), mouth if 61 in corners else eyes) for corners in painted]
        return np.any([np.hypot(columns - x, rows - y - below) < radius for (x, y), radius in middles], axis=0)

    thing = discs(8, 26, below=24)[2::4, 2::4]  # what the network sees of it

    def network(pixels):
        shares = torch.full((1, len(LABELS), *pixels.shape[2:]), 1e-6)
        share = torch.from_numpy(thing * np.float32(0.6))
        shares[:, LABELS.index("other")], shares[:, LABELS.index("skin")] = share, 1.0 - share
        return shares.log()

    monkeypatch.setattr(parser, "load_parser", lambda *_: network)
    image = np.where(discs(34, 50)[..., None], np.float32([0.3, 0.2, 0.6]), track.image)
    eye = tuple(track.landmarks[[159, 145], 1::-1].astype(int).T)
    found = parse(dataclasses.replace(track, image=image), head).other[eye]
    assert np.all((found > 0.5) == is_thing), found


def test_what_hangs_far_from_a_head_in_the_colors_of_skin_is_no_hair():
    """Bare shoulders and arms, the person's or a neighbour's, beside long hair."""
    side = 96
    picture, shares, near = (
        torch.full((3, side, side), 0.5),
        torch.full((len(LABELS), side, side), 1e-6),
        torch.zeros(side, side),
    )
    brown, bare = (torch.tensor(color)[:, None, None] for color in ([0.25, 0.16, 0.1], [0.8, 0.6, 0.5]))
    areas = {"hair": (slice(0, 20), brown), "skin": (slice(20, 40), bare), "falls": (slice(60, 75), brown)}
    areas["arm"] = slice(80, 95), bare
    for name, (rows, color) in areas.items():
        picture[:, rows] = color
        shares[LABELS.index(name if name in LABELS else "hair"), rows] = 0.7 if name == "arm" else 0.9
    near[:45] = 1.0
    given = parser._bare(shares, picture, near)
    hair, neck = (given[LABELS.index(name)] for name in ("hair", "neck"))
    assert neck[82:93].min() > 0.6
    assert hair[82:93].max() < 0.01
    torch.testing.assert_close(given[:, :75], shares[:, :75])
    torch.testing.assert_close(given.sum(0), shares.sum(0))


@pytest.mark.slow
def test_long_hair_before_clothes_is_hair(head, monkeypatch):
    """What falls on the chest was cloth and what stands off beside the neck background, and avatars' hair ended at the jaw."""
    samples = pytest.importorskip("tools.photo_parser.samples")
    monkeypatch.setattr(samples, "LONG", 1.0)
    g = np.random.default_rng(5)
    maker = samples.Maker(head, held_out=True)
    maker.refresh(g, 3, 4)
    made = [maker.make(g) for _ in range(16)]
    pictures, meshes = (
        torch.from_numpy(np.stack([getattr(one, name) for one in made])).float() for name in ("picture", "mesh")
    )
    with torch.no_grad():
        found = parser.load_parser(parser.INPUTS, len(LABELS))(parser.network_input(pictures / 255, meshes)).argmax(1).numpy()
    labels = np.stack([one.labels for one in made])
    low = (labels != samples.IGNORED) & (np.arange(parser.SIZE)[:, None] > 0.62 * parser.SIZE)
    truth, seen = (low & (part == LABELS.index("hair")) for part in (labels, found))
    assert truth.sum() > 5000
    assert (truth & seen).sum() > 0.65 * truth.sum()
    assert (truth & seen).sum() > 0.8 * seen.sum()


def test_what_is_left_out_is_said(tracks, head):
    said = left_out([tracks["admiral"], tracks["astronaut"]], head)
    assert any("The hat" in sentence and "admiral.jpg" in sentence for sentence in said)
    assert not any("The hat" in sentence and "astronaut.jpg" in sentence for sentence in said)


def test_the_mesh_beside_the_picture_turns_with_the_head(tracks, head):
    track = tracks["astronaut"]
    vertices = head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))
    small = track.camera.resized(128, 128)
    planes = mesh_channels(head, vertices, small)
    parts, up, across = planes[: len(MESH_PARTS)], planes[-2], planes[-1]
    assert parts.sum(0).max() == 1.0
    assert all(plane.any() for name, plane in zip(MESH_PARTS, parts, strict=True) if name != "mouth")
    chin, brow = ((track.landmarks_fitted[i] / 4).astype(int) for i in (152, 10))
    assert up[brow[1], brow[0]] > up[chin[1], chin[0]] + 0.3
    mirrored = mesh_channels(
        head,
        vertices * [-1, 1, 1],
        dataclasses.replace(
            small, cx=128 - small.cx, world_to_camera=np.diag([-1, 1, 1, 1]) @ small.world_to_camera @ np.diag([-1, 1, 1, 1])
        ),
    )
    np.testing.assert_allclose(mirrored[-1][:, ::-1], -across, atol=1e-5)


def test_every_triangle_belongs_to_one_part(head):
    owner = face_parts(head)
    assert set(np.unique(owner)) == set(range(len(MESH_PARTS)))
    assert (owner[np.isin(head.faces, head.regions["left_eyeball"]).all(1)] == list(MESH_PARTS).index("eyes")).all()


def test_another_file_is_refused_in_a_sentence(monkeypatch):
    monkeypatch.setattr(parser_network, "ASSET", parser_network.ASSET.with_name("landmark_noise.safetensors"))
    with pytest.raises(FileFormatError, match="install the project again"):
        parser_network.load_parser.__wrapped__(15, len(LABELS))
