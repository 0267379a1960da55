"""The rules of 3D Gaussian splatting that every backend obeys, as constants, and the numbers of a camera that they need.

Needs numpy only. Sources: Kerbl et al. 2023 (3DGS: projection, dilation, thresholds), Zwicker et al. 2001 (EWA), Yu et al. 2024
(Mip-Splatting: opacity compensation). Read by `reference.py`, `cpu/` and `cuda/`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.camera import Camera

DILATION = 0.3  # px^2 added to both variances of a projected Gaussian, so that none is thinner than a pixel
ALPHA_MIN = 1.0 / 255.0  # a Gaussian is skipped at a pixel where it covers less
TRANSMITTANCE_MIN = 1.0 / 255.0  # the Gaussian that would take a pixel's transmittance below this ends it and covers the rest
NEAR = 0.01  # metres; Gaussians whose centre is nearer to the camera plane are dropped
CLAMP_MARGIN = 0.15  # of the field of view on either side: 1.3 times the half field of view of a centred camera
COMPENSATION_MIN = 2.5e-5  # floor of det / det_dilated under the square root of the antialiasing compensation
TILE = 16  # pixels: edge of the square tiles


@dataclass(frozen=True)
class View:
    """A camera as the rasterisers read it.

    Attributes:
        rotation: [3, 3] float64, world to camera (with the world's scale, where the camera carries one).
        translation: [3] float64, camera coordinates of the world's origin.
        fx, fy, cx, cy: Pixels; see `Camera`.
        clamp: [4] float64: lowest and highest x / z, lowest and highest y / z of the Jacobian's expansion point.
        width, height: Pixels.
        orthographic: Parallel projection.
    """

    rotation: np.ndarray
    translation: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    clamp: np.ndarray
    width: int
    height: int
    orthographic: bool

    @staticmethod
    def of(camera: Camera, frame: Camera | None = None) -> View:
        """Return the numbers of `camera`.

        Args:
            camera: What to draw.
            frame: The camera of the whole picture where `camera` is a crop of it. 3DGS bounds the point at which it expands the
                perspective by the field of view; with the whole picture's bounds a crop equals its region of the whole picture
                to the last Gaussian, also for large ones that reach in from far outside.
        """
        whole = camera if frame is None else frame
        low_x, high_x = sorted(((0.0 - whole.cx) / whole.fx, (whole.width - whole.cx) / whole.fx))
        low_y, high_y = sorted(((0.0 - whole.cy) / whole.fy, (whole.height - whole.cy) / whole.fy))
        margin_x, margin_y = CLAMP_MARGIN * (high_x - low_x), CLAMP_MARGIN * (high_y - low_y)
        return View(
            rotation=np.ascontiguousarray(camera.world_to_camera[:3, :3]),
            translation=np.ascontiguousarray(camera.world_to_camera[:3, 3]),
            fx=float(camera.fx),
            fy=float(camera.fy),
            cx=float(camera.cx),
            cy=float(camera.cy),
            clamp=np.array([low_x - margin_x, high_x + margin_x, low_y - margin_y, high_y + margin_y]),
            width=int(camera.width),
            height=int(camera.height),
            orthographic=bool(camera.orthographic),
        )
