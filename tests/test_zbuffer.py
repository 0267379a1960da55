"""Mesh depth: against ray casting by hand, shared edges, clipping at the near plane, orthographic cameras."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.camera import Camera
from grmm_core.errors import ShapeError
from grmm_core.zbuffer import EMPTY, triangle_depth, visible_fraction


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


def test_visible_fraction_softens_the_edge():
    camera = Camera(np.eye(4), 10.0, 10.0, 8.0, 8.0, 16, 16)
    left_half = np.array([[[-9, -9, 1], [0.05, -9, 1], [0.05, 9, 1]], [[-9, -9, 1], [0.05, 9, 1], [-9, 9, 1]]], float)
    occluders = triangle_depth(left_half, camera, samples=4)
    visible = visible_fraction(np.full((16, 16), 2.0, np.float32), occluders, 4)
    np.testing.assert_array_equal(visible[5], [0] * 8 + [0.5] + [1] * 7)
    in_front = visible_fraction(np.full((16, 16), 0.5, np.float32), occluders, 4)
    assert (in_front == 1).all()


def test_wrong_shape_is_refused():
    with pytest.raises(ShapeError, match=r"\(T, 3, 3\)"):
        triangle_depth(np.zeros((4, 3)), Camera(np.eye(4), 1.0, 1.0, 1.0, 1.0, 2, 2))


def test_nothing_and_nan_give_an_empty_picture():
    camera = Camera(np.eye(4), 10.0, 10.0, 8.0, 8.0, 16, 16)
    assert (triangle_depth(np.zeros((0, 3, 3)), camera) == EMPTY).all()
    assert (triangle_depth(np.full((1, 3, 3), np.nan), camera) == EMPTY).all()
