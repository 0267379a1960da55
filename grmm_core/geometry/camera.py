"""Pinhole and orthographic cameras in OpenCV axes (x right, y down, z forward).

One immutable type for the command line, the studio, Blender and every rasteriser backend. Needs numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ShapeError

_GL_TO_CV = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL camera axes (y up, z backward) to OpenCV
_NEAREST = 1e-6  # metres; nothing is divided by less
_SAME = 1e-6  # what a scale differs by from 1 by rounding


@dataclass(frozen=True)
class Camera:
    """A calibrated camera.

    A point p in the world (for avatars: head space, metres) has camera coordinates (X, Y, Z) = world_to_camera @ [p, 1] and
    pixel coordinates (fx X / Z + cx, fy Y / Z + cy), or (fx X + cx, fy Y + cy) when orthographic. The centre of the first
    pixel is (0.5, 0.5).

    Attributes:
        world_to_camera: [4, 4] float64 rigid transform (may carry a uniform scale of the world).
        fx, fy: Focal lengths in pixels; pixels per metre when orthographic.
        cx, cy: Principal point in pixels. Lens shift and crops move it, also outside the picture.
        width, height: Picture size in pixels.
        orthographic: Parallel projection.
    """

    world_to_camera: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    orthographic: bool = False

    def __post_init__(self) -> None:
        matrix = np.array(self.world_to_camera, np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ShapeError("The camera matrix must be 4x4 with finite numbers.")
        if not (self.width > 0 and self.height > 0):
            raise ShapeError(f"The picture size {self.width}x{self.height} is empty; give at least one pixel.")
        if not all(math.isfinite(v) for v in (self.fx, self.fy, self.cx, self.cy)) or self.fx * self.fy == 0:
            raise ShapeError("The camera's focal length and principal point must be finite, and the focal length not zero.")
        matrix.flags.writeable = False
        object.__setattr__(self, "world_to_camera", matrix)

    @property
    def position(self) -> np.ndarray:
        """Camera centre in the world, [3]; for an orthographic camera the origin of its plane."""
        return np.linalg.inv(self.world_to_camera)[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Unit viewing direction in the world, [3]."""
        axis = self.world_to_camera[2, :3]
        return axis / np.linalg.norm(axis)

    def view_direction(self, target: np.ndarray) -> np.ndarray:
        """Unit vector from `target` [3] towards the camera, [3]: the paper's d."""
        vector = -self.forward if self.orthographic else self.position - np.asarray(target, np.float64)
        length = float(np.linalg.norm(vector))
        return vector / length if length > 1e-12 else -self.forward

    def transformed(self, model_to_world: np.ndarray) -> Camera:
        """Return this camera as seen from a model's space (eq. 2): world_to_camera @ model_to_world, [4, 4]."""
        return replace(self, world_to_camera=self.world_to_camera @ np.asarray(model_to_world, np.float64))

    def unscaled(self) -> tuple[Camera, float]:
        """The same picture without the scale of `transformed`, and that scale: a depth over it is in the model's own metres."""
        linear = self.world_to_camera[:3, :3]
        size = float(np.cbrt(np.abs(np.linalg.det(linear))))
        if abs(size - 1.0) < _SAME:
            return self, 1.0
        focal = size if self.orthographic else 1.0
        placed = np.concatenate([self.world_to_camera[:3] / size, self.world_to_camera[3:]])
        return replace(self, world_to_camera=placed, fx=self.fx * focal, fy=self.fy * focal), size

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return camera coordinates [N, 3] in metres and pixels [N, 2] of points of the world [N, 3].

        The pixels of points behind a perspective camera mean nothing; look at the camera's z.
        """
        local = np.asarray(points, np.float64) @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        divisor = 1.0 if self.orthographic else np.maximum(local[:, 2:], _NEAREST)
        return local, local[:, :2] / divisor * [self.fx, self.fy] + [self.cx, self.cy]

    def crop(self, x: int, y: int, width: int, height: int) -> Camera:
        """Return the camera of the region whose upper left corner is (x, y)."""
        return replace(self, cx=self.cx - x, cy=self.cy - y, width=width, height=height)

    def resized(self, width: int, height: int) -> Camera:
        """Return the same view at another resolution; the pixel aspect changes when the ratio does."""
        sx, sy = width / self.width, height / self.height
        return replace(self, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy, width=width, height=height)

    @staticmethod
    def orbit(
        width: int,
        height: int,
        yaw: float = 0.0,
        pitch: float = 0.0,
        distance: float = 1.0,
        fov: float = 20.0,
        target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Camera:
        """Return a camera on a sphere around `target` that looks at it.

        Args:
            width: Pixels.
            height: Pixels.
            yaw: Degrees; 0 sees the face from the front (+z), positive walks to the subject's left (+x).
            pitch: Degrees; positive looks from above.
            distance: Metres from the target.
            fov: Angle of view of the picture's shorter side, degrees.
            target: Point looked at, head space, metres.
        """
        if not 0.0 < fov < 180.0 or not distance > 0.0:
            raise ShapeError("The camera needs a distance above 0 and a field of view between 0 and 180 degrees.")
        if not (math.isfinite(yaw) and math.isfinite(pitch)):
            raise ShapeError(f"The camera's yaw {yaw} and pitch {pitch} must be finite numbers of degrees.")
        a, b = math.radians(yaw), math.radians(pitch)
        backward = np.array([math.sin(a) * math.cos(b), math.sin(b), math.cos(a) * math.cos(b)])
        right = np.array([math.cos(a), 0.0, -math.sin(a)])
        rotation = np.stack([right, -np.cross(backward, right), -backward])  # rows x right, y down, z forward
        eye = np.asarray(target, np.float64) + distance * backward
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = -rotation @ eye
        focal = min(width, height) / (2.0 * math.tan(math.radians(fov) / 2.0))
        return Camera(matrix, focal, focal, width / 2.0, height / 2.0, width, height)

    @staticmethod
    def from_opengl(view: np.ndarray, projection: np.ndarray, width: int, height: int) -> Camera:
        """Return the camera of OpenGL view and projection matrices, such as Blender's `calc_matrix_camera` gives.

        Args:
            view: World to OpenGL camera (x right, y up, z backward), [4, 4]; without scale.
            projection: Perspective or orthographic clip matrix, [4, 4]. Lens shift and pixel aspect are in it.
            width: Pixels.
            height: Pixels.
        """
        projection = np.asarray(projection, np.float64)
        orthographic = bool(abs(projection[3, 3]) > 0.5)
        fx = projection[0, 0] * width / 2.0
        fy = projection[1, 1] * height / 2.0
        # Perspective: x_ndc = (p00 X + p02 Z) / -Z with Z negative in front; orthographic: x_ndc = p00 X + p03.
        shift_x = projection[0, 3] if orthographic else -projection[0, 2]
        shift_y = projection[1, 3] if orthographic else -projection[1, 2]
        cx = (1.0 + shift_x) * width / 2.0
        cy = (1.0 - shift_y) * height / 2.0
        return Camera(_GL_TO_CV @ np.asarray(view, np.float64), fx, fy, cx, cy, width, height, orthographic)
