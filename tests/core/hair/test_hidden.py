"""What other strands hide is not drawn: behind a dense curtain, a layer deep at least, and not past its border."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.geometry.camera import Camera
from grmm_core.hair.hidden_kernels import LAYER, bury, place, thicken
from grmm_core.hair.ribbons import Eye

SIZE, CELL, NEAR = 128, np.float32(4.0), 0.25


def curtain(z: float, width: float, count: int) -> np.ndarray:
    """Strands that hang side by side at a depth, [count, 5, 3]."""
    x, y = np.linspace(-width, width, count), np.linspace(0.08, -0.08, 5)
    return np.stack(np.broadcast_arrays(x[:, None], y, z), -1).astype(np.float32)


def left(count: int, opacity: float = 1.0, orthographic: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Which segments of a near curtain and of a far and wider one are left, each [N, 4] bool."""
    camera = Camera.orbit(SIZE, SIZE, 0.0)
    if orthographic:
        camera = Camera(camera.world_to_camera, 500.0, 500.0, camera.cx, camera.cy, SIZE, SIZE, orthographic=True)
    eye = Eye.of(camera).numbers()
    front, behind = curtain(0.05, 0.06, count), curtain(-0.05, 0.10, 81)
    points = np.concatenate([front, behind])
    radii = np.full((len(points), 2), 0.0008, np.float32)
    seen = np.ones((len(points), 4), np.float32)
    shown = np.empty((*points.shape[:2], 4), np.float32)
    place(points.reshape(-1, 3), eye, shown.reshape(-1, 4))
    near = np.float32(eye[11] - NEAR)
    thick = np.zeros((SIZE // 4, SIZE // 4, int(2 * NEAR / LAYER)), np.float32)
    cells = CELL, np.float32(-camera.cx), np.float32(-camera.cy), near
    thicken(shown, radii, np.full(len(points), opacity, np.float32), seen, np.float32(1.0), *cells, thick)
    middles = (0.5 * (shown[:, 1:] + shown[:, :-1])).reshape(-1, 4)
    bury(middles, *cells, thick, np.float32(5.0), seen.reshape(-1))
    kept = seen > 0
    return kept[:count], kept[count:]


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_dense_curtain_hides_what_hangs_behind_it_alone(orthographic):
    front, behind = left(1200, orthographic=orthographic)
    x = np.linspace(-0.10, 0.10, 81)
    assert front.all()
    assert not behind[np.abs(x) < 0.03][:, 1:3].any()
    assert behind[np.abs(x) > 0.08].all()


@pytest.mark.parametrize(("count", "opacity"), [(60, 1.0), (1200, 0.05)])
def test_a_thin_curtain_hides_nothing(count, opacity):
    front, behind = left(count, opacity)
    assert front.all()
    assert behind.all()
