"""Hair that swings: still on a still head, late behind a moving one, never inside it, the same each time and in both twins."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.errors import ConfigError, FileFormatError, ShapeError
from grmm_core.geometry.triangles import closest_on_surface, vertex_normals
from grmm_core.hair import join, library_groom
from grmm_core.hair.body import Body, worn
from grmm_core.hair.contact import moved
from grmm_core.hair.groom import Groom
from grmm_core.hair.roots import SCALP
from grmm_core.hair.swing import Swing, SwingBake, write_bake
from grmm_core.head import load_open_head

FPS = 24.0


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def groom() -> Groom:
    long = library_groom("long")
    reaches = np.linalg.norm(np.diff(long.points.reshape(len(long), -1, 3), axis=1), axis=2).sum(1) > 0.18
    return join([long.select(np.flatnonzero(reaches)).level(0.05), library_groom("natural", part="brows").level(0.1)])


def posed(head, yaw: float) -> np.ndarray:
    pose = np.zeros((5, 3))
    pose[1, 1] = yaw
    return np.asarray(head.vertices(np.zeros(300), np.zeros(1), pose), float)


@pytest.fixture(scope="module")
def shaken(head) -> list[np.ndarray]:
    """A head that turns to the side within six frames and stops, for two seconds."""
    return [posed(head, 0.9 * min(frame / 6, 1.0)) for frame in range(48)]


@pytest.fixture(scope="module")
def played(head, groom, shaken) -> np.ndarray:
    return np.stack(list(Swing(head, groom, np.asarray(head.v_template, float), FPS).frames(shaken)))


def test_a_still_head_wears_its_groom(head, groom):
    rest = np.asarray(head.v_template, float)
    for frame in Swing(head, groom, rest, FPS).frames([rest] * 5):
        assert np.abs(frame).max() < 2e-4


def test_hair_lags_swings_past_and_comes_to_rest(head, groom, played):
    far = np.linalg.norm(played, axis=3)
    scalp = groom.groups == 0
    tips, middles = far[:, scalp, -1].mean(1), far[:, scalp, 3].mean(1)
    assert tips[5] > 0.02  # late by centimetres
    assert tips[5] > 1.5 * middles[5]
    late = np.abs(np.diff(played[-12:], axis=0)).max((0, 3))
    assert (late < 1e-3).mean() > 0.99  # at rest, on the shoulders
    assert late.max() < 4e-3
    assert not played[:, ~scalp].any()  # brows stay
    assert not np.abs(played[:, :, 0]).max() > 1e-6  # so do roots
    side = played[:, scalp, -1]
    past = [float(((side[5] * side[frame]).sum(1) < 0).mean()) for frame in range(6, 20)]
    assert max(past) > 0.4  # many swing past their place


def drawn(head, groom, vertices, offsets) -> tuple[np.ndarray, np.ndarray]:
    """Scalp hair of a posed head as it is drawn, [N, K, 3], without and with what swings."""
    rest, scalp = np.asarray(head.v_template, float), groom.groups == SCALP
    some = worn(head, rest, groom.select(scalp))
    still = some.posed(some.frames(rest, head.faces), vertices).reshape(len(some), -1, 3)
    return still, moved(still, offsets[scalp])


def test_strands_keep_their_lengths(head, groom, shaken, played):
    for number in (4, 8, 20):
        still, points = drawn(head, groom, shaken[number], played[number])
        before, after = (np.linalg.norm(np.diff(part, axis=1), axis=2).sum(1) for part in (still, points))
        short, long = np.percentile(after / before, (5, 99))
        assert short > 0.85  # what was folded by contact is smoothed
        assert long < 1.01


def test_nothing_is_inside_the_head_or_the_shoulders(head, groom, shaken, played):
    """Measured to the triangles of the posed skin, at every point of the strands that are drawn."""
    inner = np.zeros(len(head.v_template), bool)
    inner[np.concatenate([head.regions[name] for name in ("mouth_interior", "left_eyeball", "right_eyeball")])] = True
    faces = np.asarray(head.faces)[(np.asarray(head.uv_islands) == 0) & ~inner[np.asarray(head.faces)].any(1)]
    edges, number = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1), axis=0, return_counts=True)
    border = np.isin(faces, edges[number == 1])
    beneath = 0
    for frame in (4, 8, 20):
        vertices = shaken[frame]
        normals = vertex_normals(vertices, faces)
        still, points = drawn(head, groom, vertices, played[frame])
        for way, strands in enumerate((still, points)):
            asked = strands[:, 2:].reshape(-1, 3)  # the first are in the skin that they grow from
            asked = asked[Body.of(head, vertices).heights(asked)[0] < 0.002][:: 4 - 3 * way]
            triangles, weights, far = closest_on_surface(asked, vertices, faces)
            corners = vertices[faces[triangles]]
            nearest = (weights[..., None] * corners).sum(1)
            outwards = (weights[..., None] * normals[faces[triangles]]).sum(1)
            inside = ((asked - nearest) * outwards).sum(1) < 0.0
            inside &= ~(border[triangles] & (weights > 0.0)).any(1)  # below the rim nothing is inside
            if way:
                assert not (inside & (far > 0.003)).any()
                assert (inside & (far > 0.001)).sum() < 1e-3 * points.size / 3
            else:
                beneath += int((inside & (far > 0.01)).sum())
    assert beneath > 10  # hair that follows the head alone would be


def test_it_is_the_same_each_time_and_a_cut_starts_anew(head, groom, shaken, played):
    swing = Swing(head, groom, np.asarray(head.v_template, float), FPS)
    np.testing.assert_array_equal(np.stack(list(swing.frames(shaken[:4]))), played[:4])
    swing.step(shaken[3])
    away = swing.step(shaken[3] + np.array([0.5, 0.0, 0.0]))
    fresh = next(iter(Swing(head, groom, np.asarray(head.v_template, float), FPS).frames([shaken[3] + np.array([0.5, 0, 0])])))
    np.testing.assert_array_equal(away, fresh)


def test_the_compiled_kernel_does_what_its_twin_does(head, groom, shaken, played):
    readable = Swing(head, groom, np.asarray(head.v_template, float), FPS, compiled=False)
    for number, frame in enumerate(readable.frames(shaken[:3])):
        off = np.abs(frame - played[number]).max(2)
        assert (off < 3e-4).mean() > 0.995  # a place that just touches an ear may slide to either side of it
        assert off.max() < 0.01


def test_a_bake_gives_any_frame_in_any_order(head, groom, shaken, played, tmp_path):
    path = tmp_path / "hair.npz"
    assert write_bake(path, iter(played[:10]), 100, FPS) == 10
    bake = SwingBake.read(path)
    for frame in (107, 101, 109, 101):
        np.testing.assert_allclose(bake.at(frame, len(groom)), played[frame - 100], atol=6e-5)
    np.testing.assert_array_equal(bake.at(5, len(groom)), bake.at(100, len(groom)))
    write_bake(tmp_path / "same.npz", iter(played[:10]), 100, FPS)
    write_bake(tmp_path / "less.npz", iter(0.5 * played[:10]), 100, FPS)
    digests = [SwingBake.read(tmp_path / f"{name}.npz").digest for name in ("hair", "same", "less")]
    assert digests[0] == digests[1] != digests[2]
    with pytest.raises(ShapeError, match="bake it again"):
        bake.at(100, len(groom) + 1)
    np.savez(tmp_path / "other.npz", frames=np.zeros(3))
    with pytest.raises(FileFormatError, match="no baked hair"):
        SwingBake.read(tmp_path / "other.npz")
    with pytest.raises(ConfigError, match="frames a second"):
        Swing(head, groom, np.asarray(head.v_template, float), 0.0)
