"""Mesh depth: against ray casting by hand, shared edges, clipping at the near plane, orthographic cameras.

Every test runs with numpy alone and with the compiled form; the last ones hold the two to the same picture.
"""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest

from grmm_core.errors import ShapeError
from grmm_core.geometry import zbuffer, zbuffer_numpy
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY, mean_of_samples, triangle_depth


def choose_form(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make `triangle_depth` use the form "numpy" or "numba"."""
    if name == "numpy":
        monkeypatch.setattr(zbuffer, "_compiled_draw", lambda: None)
    else:
        draw = importlib.import_module("grmm_core.geometry.zbuffer_kernel").draw
        monkeypatch.setattr(zbuffer, "_compiled_draw", lambda: draw)


@pytest.fixture(params=["numpy", "numba"], autouse=True)
def form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    choose_form(request.param, monkeypatch)
    return request.param


def cast(triangles: np.ndarray, camera: Camera, near: float = 1e-4) -> np.ndarray:
    """The slow twin: intersect every triangle with every pixel's ray."""
    local = triangles @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    px, py = (xs - camera.cx) / camera.fx, (ys - camera.cy) / camera.fy
    zero = np.zeros_like(px)
    origin = np.stack([px, py, zero], -1) if camera.orthographic else np.zeros((*px.shape, 3))
    ray = np.stack([zero, zero, zero + 1] if camera.orthographic else [px, py, zero + 1], -1)
    depth = np.full(px.shape, float(EMPTY))
    for a, b, c in local:
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((a - origin) @ normal) / (ray @ normal)
        hit = origin + t[..., None] * ray
        sides = [np.cross(e - s, hit - s) @ normal for s, e in ((a, b), (b, c), (c, a))]
        inside = np.all([s >= 0 for s in sides], axis=0) & (hit[..., 2] >= near)
        depth = np.where(inside & (hit[..., 2] < depth), hit[..., 2], depth)
    return depth


@pytest.mark.parametrize("orthographic", [False, True])
def test_equals_ray_casting(orthographic: bool):
    rng = np.random.default_rng(3)
    camera = Camera.orbit(61, 47, yaw=25.0, pitch=10.0, distance=1.0, fov=40.0)
    if orthographic:
        camera = Camera(camera.world_to_camera, 60.0, 55.0, 33.2, 21.7, 61, 47, orthographic=True)
    triangles = rng.uniform(-0.6, 0.6, (60, 1, 3)) + rng.uniform(-0.4, 0.4, (60, 3, 3))
    ours, slow = triangle_depth(triangles, camera), cast(triangles, camera)
    same = np.isclose(ours, slow, rtol=1e-4)
    # A sample exactly on an edge may fall to either side.
    assert same.mean() > 0.999
    assert (slow < EMPTY).mean() > 0.5


def test_triangles_behind_and_through_the_near_plane():
    camera = Camera(np.eye(4), 20.0, 20.0, 16.0, 16.0, 32, 32)
    behind = np.array([[[-1, -1, -2], [1, -1, -2], [0, 1, -2]]], float)
    assert (triangle_depth(behind, camera) == EMPTY).all()
    floor = np.array([[[-50, 1, -50], [50, 1, -50], [50, 1, 50]], [[-50, 1, -50], [50, 1, 50], [-50, 1, 50]]], float)
    np.testing.assert_allclose(triangle_depth(floor, camera), cast(floor, camera), rtol=1e-4)
    near_wall = np.array([[[-1, -1, 0.5], [1, -1, 0.5], [0, 1, 0.5]]], float)
    assert (triangle_depth(near_wall, camera, near=0.6) == EMPTY).all()
    assert (triangle_depth(near_wall, camera, far=0.4) == EMPTY).all()


def test_shared_edges_leave_no_gap():
    n = 23
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.linspace(-2, 2, n), np.linspace(-2, 2, n)), -1) + rng.uniform(-0.05, 0.05, (n, n, 2))
    points = np.concatenate([grid, np.full((n, n, 1), 2.0)], -1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    triangles = np.stack([np.stack([a, b, c], -2), np.stack([a, c, d], -2)]).reshape(-1, 3, 3)
    depth = triangle_depth(triangles, Camera(np.eye(4), 40.0, 40.0, 32.0, 32.0, 64, 64), samples=3)
    np.testing.assert_allclose(depth, 2.0, rtol=1e-5)


def test_the_mean_of_the_samples_softens_the_edge():
    camera = Camera(np.eye(4), 10.0, 10.0, 8.0, 8.0, 16, 16)
    left_half = np.array([[[-9, -9, 1], [0.05, -9, 1], [0.05, 9, 1]], [[-9, -9, 1], [0.05, 9, 1], [-9, 9, 1]]], float)
    occluders = triangle_depth(left_half, camera, samples=4)
    grid = occluders.reshape(16, 4, 16, 4)
    visible = mean_of_samples(lambda row, column: grid[:, row, :, column] > 2.0, 4)
    np.testing.assert_array_equal(visible[5], [0] * 8 + [0.5] + [1] * 7)
    in_front = mean_of_samples(lambda row, column: grid[:, row, :, column] > 0.5, 4)
    assert (in_front == 1).all()


def test_wrong_shape_is_refused():
    with pytest.raises(ShapeError, match=r"\(T, 3, 3\)"):
        triangle_depth(np.zeros((4, 3)), Camera(np.eye(4), 1.0, 1.0, 1.0, 1.0, 2, 2))


def test_nothing_and_nan_give_an_empty_picture():
    camera = Camera(np.eye(4), 10.0, 10.0, 8.0, 8.0, 16, 16)
    assert (triangle_depth(np.zeros((0, 3, 3)), camera) == EMPTY).all()
    assert (triangle_depth(np.full((1, 3, 3), np.nan), camera) == EMPTY).all()


def scattered(rng: np.random.Generator, size: float) -> np.ndarray:
    """Triangles of a size all around the origin."""
    return rng.uniform(-0.6, 0.6, (300, 1, 3)) + rng.uniform(-size, size, (300, 3, 3))


def degenerate(rng: np.random.Generator) -> np.ndarray:
    """Points, lines and slivers among triangles whose corners lie on a grid, some with corners that are no numbers."""
    triangles = np.round(scattered(rng, 0.3) * 16) / 16
    triangles[:40, 1] = triangles[:40, 0]
    triangles[40:80, 2] = 2 * triangles[40:80, 1] - triangles[40:80, 0]
    triangles[80:120, 2] = triangles[80:120, 1] + rng.uniform(-1e-7, 1e-7, (40, 3))
    triangles[120:124, 0, 1] = [np.nan, np.nan, 1e200, -1e200]
    return triangles


def grid(columns: int) -> np.ndarray:
    """A wall of squares cut in two whose edges run through sample centres."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, columns), np.linspace(-0.5, 0.5, columns))
    points = np.stack([x, y, 0.3 * x * y], -1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.stack([np.stack([a, b, c], -2), np.stack([a, c, d], -2)]).reshape(-1, 3, 3)


TRIANGLES = {
    "tiny": lambda rng: scattered(rng, 0.01),
    "small": lambda rng: scattered(rng, 0.1),
    "large": lambda rng: scattered(rng, 2.0),
    "degenerate": degenerate,
    "shared edges": lambda rng: grid(33),
}


@pytest.mark.parametrize("form", ["numpy"], indirect=True)
@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("distance", [0.2, 1.0])  # at 0.2 many triangles are behind the camera or cross the near plane
@pytest.mark.parametrize("name", TRIANGLES)
def test_both_forms_draw_the_same(name: str, distance: float, orthographic: bool, form: str, monkeypatch: pytest.MonkeyPatch):
    triangles = TRIANGLES[name](np.random.default_rng(5))
    camera = Camera.orbit(64, 48, yaw=0.0 if name == "shared edges" else 25.0, pitch=0.0, distance=distance, fov=40.0)
    if orthographic:
        camera = Camera(camera.world_to_camera, 64.0, 64.0, 32.0, 24.0, 64, 48, orthographic=True)
    for samples, near, far in ((1, 1e-4, float(EMPTY)), (3, 0.1, 1.2)):
        choose_form("numpy", monkeypatch)
        with np.errstate(over="ignore", invalid="ignore"):
            plain = triangle_depth(triangles, camera, samples, near, far)
            choose_form("numba", monkeypatch)
            compiled = triangle_depth(triangles, camera, samples, near, far)
        np.testing.assert_allclose(compiled, plain, rtol=1e-6)
        assert (plain < EMPTY).any()
        assert (plain[plain < EMPTY] <= np.float32(far)).all()


def test_large_triangles_are_drawn_in_pieces(monkeypatch: pytest.MonkeyPatch):
    camera = Camera.orbit(64, 48, yaw=25.0, pitch=0.0, distance=1.0, fov=40.0)
    triangles = scattered(np.random.default_rng(7), 1.0)
    whole = triangle_depth(triangles, camera)
    monkeypatch.setattr(zbuffer_numpy, "_CHUNK", 50)
    np.testing.assert_array_equal(triangle_depth(triangles, camera), whole)


@pytest.mark.parametrize("window", [(0, 0, 64, 48), (10, 5, 40, 33), (63, 47, 64, 48), (0, 20, 64, 21)])
@pytest.mark.parametrize("name", TRIANGLES)
def test_a_part_has_the_values_of_the_whole(name: str, window: tuple[int, int, int, int]):
    triangles = TRIANGLES[name](np.random.default_rng(9))
    camera = Camera.orbit(64, 48, yaw=10.0, pitch=5.0, distance=0.9, fov=45.0)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        whole = triangle_depth(triangles, camera, 3)
        part = triangle_depth(triangles, camera, 3, window=window)
    left, top, right, bottom = (3 * edge for edge in window)
    np.testing.assert_array_equal(part, whole[top:bottom, left:right])
    assert (whole < EMPTY).any()


@pytest.mark.parametrize("form", ["numpy"], indirect=True)
def test_numpy_alone_is_enough(form: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "grmm_core.geometry.zbuffer_kernel", None)  # its import fails, as where numba is missing
    zbuffer._compiled_draw.cache_clear()
    wall = np.array([[[-9, -9, 1], [9, -9, 1], [0, 9, 1]]], float)
    depth = triangle_depth(wall, Camera(np.eye(4), 10.0, 10.0, 8.0, 8.0, 16, 16))
    assert zbuffer._compiled_draw() is None
    zbuffer._compiled_draw.cache_clear()
    assert (depth < EMPTY).any()


@pytest.mark.parametrize("form", ["numba"], indirect=True)
def test_the_compiled_form_is_chosen_by_itself(form: str, monkeypatch: pytest.MonkeyPatch):
    wanted = zbuffer._compiled_draw()
    monkeypatch.undo()
    assert zbuffer._compiled_draw() is wanted
