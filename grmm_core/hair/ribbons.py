"""Strands as chains of Gaussians, and what light does to them; for numpy and torch, the readable twin of `strand_kernels`.

A strand of K points becomes K - 1 Gaussians: centre in the middle of its segment, long axis along it. A strand is often far
thinner than a pixel, and the rasteriser widens every Gaussian by `DILATION`; its opacity is lowered by as much as it grows
(Yu et al. 2024, Mip-Splatting), and raised by `ALPHA_MIN`: the rasteriser leaves out where a Gaussian covers less, which is
that share of 2 pi sqrt(det) of its area on the picture whatever its opacity, much of a faint one. So thousands of fine strands
cover what they should, and as much as few wide ones.

Shading: a strand is a matte cylinder with a white glint (Kajiya and Kay 1989) as broad as that of many hairs that do not lie
quite alike, lit by the even rig of the capture studio, which the colors of the skin stand for. How much of a lamp reaches a
point inside the hair is known from the groom at rest (`occlusion`). The factors are the least squares' over the studio's
pictures of eleven people whose strands and albedo are known. More sheen than there adds a narrow glint in the hair's color
(Marschner et al. 2003).
"""

from __future__ import annotations

from typing import Generic, NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..geometry.libraries import Array, as_like, library_of
from ..splat.rules import ALPHA_MIN, DILATION

OPACITY = 0.97  # of a strand
LONG = 0.42  # of a segment's length: standard deviation along it
WIDE = 1.0 / (np.pi * LONG * OPACITY)  # of half the diameter, across: a chain of Gaussians covers what a ribbon does
TINY = 1e-9  # metres; keeps directions of empty segments defined
SMALLEST = 1e-6  # px^2; keeps the antialiasing factor of invisible strands defined

AMBIENT = 0.46  # radiance of a white matte surface under the rig's world, with what other strands scatter
# of the rig's lamps: unit direction in head space and radiance of a white matte surface that faces it
LAMPS = np.array([
    (0.468, 0.469, 0.749, 0.72), (-0.636, 0.309, 0.707, 0.41), (0.785, 0.423, -0.453, 0.32), (-0.785, 0.423, -0.453, 0.32),
    (0.0, 0.966, 0.259, 0.32), (0.0, 0.174, -0.985, 0.21),
], np.float32)  # fmt: skip
BACK, FRONT = 0.24, 0.455  # matte body: seen from the side away from a lamp, and what the side towards it has more
# lobes: shift of the cone, one over its width, share of it
WHITE_SHIFT, WHITE_SHARP, WHITE = 0.0, 1.5, 0.066
COLORED_SHIFT, COLORED_SHARP, COLORED = 0.24, 3.0, 0.55
DARKEST = 1e-3  # openness below which light hair gains no more from scattering
SCATTER = 0.55  # how much less light is lost inside light hair than inside black hair


class Eye(NamedTuple):
    """A camera as strands see it, in head space with metres of the head.

    Attributes:
        rotation: Head to camera axes, [3, 3].
        translation: Of the head's origin in camera axes, [3].
        focal: Pixels, or pixels per metre of an orthographic camera.
        orthographic: Parallel projection.
    """

    rotation: np.ndarray
    translation: np.ndarray
    focal: float
    orthographic: bool

    @staticmethod
    def of(camera: Camera) -> Eye:
        """Return the eye of a camera that is given in head space; it may carry a uniform scale."""
        linear = camera.world_to_camera[:3, :3]
        size = float(np.cbrt(np.linalg.det(linear)))
        focal = float(np.sqrt(abs(camera.fx * camera.fy))) * (size if camera.orthographic else 1.0)
        rotation, translation = linear / size, camera.world_to_camera[:3, 3] / size
        return Eye(rotation.astype(np.float32), translation.astype(np.float32), focal, camera.orthographic)

    def numbers(self) -> np.ndarray:
        """Rotation, translation, focal length, 1 for parallel projection: float32 [14], as the kernels read it."""
        return np.concatenate([self.rotation.ravel(), self.translation, [self.focal, self.orthographic]]).astype(np.float32)

    def pixels_per_metre(self) -> float:
        """At the head's centre; 0 where that is behind the camera."""
        if self.orthographic:
            return self.focal
        return self.focal / float(self.translation[2]) if self.translation[2] > TINY else 0.0


class Segments(NamedTuple, Generic[Array]):
    """Gaussians of strands: means [N, K-1, 3], quats [N, K-1, 4] wxyz, scales [N, K-1, 3], opacities [N, K-1]."""

    means: Array
    quats: Array
    scales: Array
    opacities: Array


def segments(points: Array, radii: Array, opacities: Array, eye: Eye | None = None) -> Segments[Array]:
    """Turn strands into Gaussians.

    Args:
        points: Head space, metres, root first, [N, K, 3].
        radii: Half the diameter at root and tip, metres, [N, 2]; between them it goes with the square of the place, as the
            studio renders it.
        opacities: Of the strands, 0..1, [N].
        eye: For whom opacities are those that the rasteriser draws as such strands; None leaves them.
    """
    library = library_of(points)
    a, b = points[:, :-1], points[:, 1:]
    means, along = (a + b) * 0.5, b - a
    length = ((along * along).sum(-1) + TINY * TINY) ** 0.5  # [N, K-1]
    sign = library.where(along[..., 0] < 0, -1.0, 1.0)  # a Gaussian is the same both ways; this way quaternions are defined
    axis = along * (sign / length)[..., None]
    half = (2.0 * (1.0 + axis[..., 0])) ** 0.5
    zero = half * 0.0
    quats = library.stack([0.5 * half, zero, -axis[..., 2] / half, axis[..., 1] / half], -1)  # turns x to the axis
    count = points.shape[1] - 1
    place = as_like(((np.arange(count) + 0.5) / count) ** 2, points)
    radius = WIDE * (radii[:, :1] + (radii[:, 1:] - radii[:, :1]) * place)  # [N, K-1]
    scales = library.stack([LONG * length, radius, radius], -1)
    opacities = opacities[:, None] + zero
    if eye is not None:
        left_out = as_like(np.array(ALPHA_MIN), opacities) * (opacities > 0)
        opacities = opacities * _compensation(means, axis, LONG * length, radius, eye) + left_out
    return Segments(means, quats, scales, opacities)


def _compensation(means: Array, axis: Array, long: Array, wide: Array, eye: Eye) -> Array:
    """Square root of a Gaussian's area on the picture over its area after dilation."""
    clip = library_of(means).clip
    rotation = as_like(eye.rotation, means)
    seen = means @ rotation.T + as_like(eye.translation, means)
    turned = axis @ rotation.T
    if eye.orthographic:
        pixels, cosine = eye.focal + 0.0 * seen[..., 2], turned[..., 2]
    else:
        pixels = eye.focal / clip(seen[..., 2], TINY, None)
        cosine = (turned * seen).sum(-1) / clip((seen * seen).sum(-1) ** 0.5, TINY, None)
    across = (pixels * wide) ** 2 + SMALLEST
    down = (pixels * long) ** 2 * (1.0 - cosine**2) + (pixels * wide) ** 2 * cosine**2 + SMALLEST
    result: Array = (across / (across + DILATION) * (down / (down + DILATION))) ** 0.5
    return result


def shade(means: Array, axes: Array, albedo: Array, light: Array, share: Array, eye: Eye, sheen: float) -> Array:
    """Return what strands look like, linear RGB.

    Args:
        means: Head space, [..., 3].
        axes: Unit direction of the strand, either way, [..., 3]; the shifts of the lobes need it from the root to the tip.
        albedo: Linear RGB, [..., 3].
        light: How open the surroundings are, on average and towards x, y and z (see `occlusion`), head space, [..., 4].
        share: What of that light each has (see `crowding`), [...].
        eye: From where.
        sheen: Factor of the white glint; what is above 1 is also that of the colored one.
    """
    library = library_of(means)
    if eye.orthographic:
        to_eye = as_like(-eye.rotation[2], means) + 0.0 * means
    else:
        to_eye = as_like(-eye.rotation.T @ eye.translation, means) - means
        to_eye = to_eye / library.clip((to_eye * to_eye).sum(-1)[..., None] ** 0.5, TINY, None)
    sine_eye = (axes * to_eye).sum(-1)
    flat_eye = library.clip(1.0 - sine_eye**2, 1e-4, None) ** 0.5
    # light hair passes on what it does not absorb
    kept = library.clip(light[..., 0], DARKEST, None) ** (-SCATTER * library.clip(albedo.mean(-1), 0.0, 1.0) ** 0.5)
    light = light * kept[..., None]
    matte = AMBIENT * light[..., 0]
    white, colored = 0.0 * matte, 0.0 * matte
    for x, y, z, power in LAMPS.tolist():
        towards = as_like((x, y, z), means)
        reaching = power * library.clip(light[..., 0] + light[..., 1:] @ towards, 0.0, 1.0)
        sine = axes @ towards
        flat = library.clip(1.0 - sine**2, 1e-4, None) ** 0.5
        facing = library.clip((to_eye @ towards - sine * sine_eye) / (flat * flat_eye), -1.0, 1.0)
        matte = matte + reaching * flat * (BACK + FRONT * (0.5 + 0.5 * facing))
        lean = sine + sine_eye
        white = white + reaching * flat / (1.0 + ((lean - WHITE_SHIFT) * WHITE_SHARP) ** 2) ** 2
        colored = colored + reaching * flat / (1.0 + ((lean - COLORED_SHIFT) * COLORED_SHARP) ** 2) ** 2
    body, glint = matte + max(sheen - 1.0, 0.0) * COLORED * colored, sheen * WHITE * white
    result: Array = share[..., None] * (albedo * body[..., None] + glint[..., None])
    return result
