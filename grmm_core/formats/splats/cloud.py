"""The splat cloud that every reader of this package returns and every writer takes.

Numbers are plain: linear scales, opacities 0..1, unit quaternions wxyz, spherical harmonics as in 3DGS. What files do to them
(logarithms, logits, channel order, fixed point, axes) is each format's own affair. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ShapeError
from ...files.access import bad_file

SH_C0 = 0.28209479177387814
"""Value of the constant spherical harmonic: color = 0.5 + SH_C0 * coefficient."""
MAX_DEGREE = 3
MAX_SPLATS = 10_000_000  # limit of packed files, whose size says little about their count; five times a large capture
_PLAIN_BYTES = 44  # of a splat in memory, without its harmonics
_ANY_SIZE = 3 << 27  # bytes of a cloud that a file of any size may make
_MOST_PACKED = 40  # times that a packed file may grow beyond that; real ones grow by less than half of it
_MIN_SCALE, _MAX_SCALE = 1e-12, 1e12
_MIN_OPACITY = 1e-6  # so that its logit is finite
_SEEN = 1.0 / 255.0
_MIN_QUATERNION = 1e-12
_HALF_STEP = 0.5 / 255.0  # of 8-bit colors
_SH_COUNTS = {(degree + 1) ** 2 for degree in range(MAX_DEGREE + 1)}

# Signs of the 16 harmonics and of a quaternion when space turns by half a turn about x (y and z change sign).
_FLIP_SH = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)
_FLIP_QUATERNION = np.array([1, 1, -1, -1], np.float32)
_FLIP_POSITION = np.array([1, -1, -1], np.float32)


@dataclass
class SplatCloud:
    """N Gaussians. In memory y is up, as in head space; with `binding` they are local to triangles instead.

    Attributes:
        means: Centres in metres, [N, 3] float32.
        quats: Unit quaternions wxyz, [N, 4] float32.
        scales: Standard deviations along the axes in metres, [N, 3] float32.
        opacities: 0..1, [N] float32.
        sh: Spherical harmonics, [N, K, 3] float32, K = 1, 4, 9 or 16.
        binding: Triangle that each Gaussian belongs to, [N] int32, or None.
        antialiased: Trained for a renderer that compensates the 0.3 px dilation.
        warnings: Sentences about what was dropped or assumed on reading.
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    sh: np.ndarray
    binding: np.ndarray | None = None
    antialiased: bool = False
    warnings: list[str] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Number of Gaussians N."""
        return int(self.means.shape[0])

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0..3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    def colors(self) -> np.ndarray:
        """Display sRGB of the constant term, [N, 3], not clipped."""
        return 0.5 + SH_C0 * self.sh[:, 0]

    @property
    def used_degree(self) -> int:
        """Degree of the highest harmonics that are not all zero."""
        return max((d for d in range(1, self.degree + 1) if (self.sh[:, d * d : (d + 1) ** 2] != 0).any()), default=0)

    def with_degree(self, degree: int) -> SplatCloud:
        """Return a copy with harmonics of another degree: zeros are added, or the higher ones left out."""
        sh = np.zeros((self.count, (degree + 1) ** 2, 3), np.float32)
        kept = min(sh.shape[1], self.sh.shape[1])
        sh[:, :kept] = self.sh[:, :kept]
        return replace(self, sh=sh)

    def summary(self) -> dict[str, object]:
        """Facts for people: what `grmm info` shows."""
        size = np.ptp(self.means, axis=0)
        where = {"size in metres": [round(float(side), 4) for side in size]} if self.binding is None else {}
        return {
            "splats": self.count,
            "degree of harmonics": self.degree,
            "bound to triangles": self.binding is not None,
            **where,
        }

    @classmethod
    def from_rgb(
        cls, means: np.ndarray, quats: np.ndarray, scales: np.ndarray, opacities: np.ndarray, rgb: np.ndarray
    ) -> SplatCloud:
        """Build a cloud of degree 0 from display colors [N, 3] 0..1: f_dc = (rgb - 0.5) / SH_C0. Raises `ShapeError`."""
        sh = ((np.asarray(rgb, np.float32) - 0.5) / SH_C0)[:, None, :]
        return cls(means, quats, scales, opacities, sh).validated()

    def validated(self) -> SplatCloud:
        """Return a copy in float32 with unit quaternions, ready for a writer.

        Raises:
            ShapeError: A wrong shape, a value that is not finite, a scale that is not positive or an opacity outside 0..1.
        """
        names = ("means", "quats", "scales", "opacities", "sh")
        arrays: dict[str, Any] = {name: np.ascontiguousarray(getattr(self, name), np.float32) for name in names}
        count = arrays["means"].shape[0] if arrays["means"].ndim else 0
        sh_count = arrays["sh"].shape[1] if arrays["sh"].ndim == 3 else 0
        shapes = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,)}
        shapes["sh"] = (count, sh_count, 3)
        if count < 1 or sh_count not in _SH_COUNTS:
            raise ShapeError(f"A splat cloud needs at least one splat and 1, 4, 9 or 16 harmonics; got {count} and {sh_count}.")
        for name, shape in shapes.items():
            if arrays[name].shape != shape:
                raise ShapeError(f"SplatCloud.{name} has shape {arrays[name].shape}; it must be {shape}.")
            if not np.isfinite(arrays[name]).all():
                raise ShapeError(f"SplatCloud.{name} has values that are not finite; remove these splats first.")
        lengths = np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
        if (arrays["scales"] <= 0).any() or (lengths < _MIN_QUATERNION).any():
            raise ShapeError("Scales of splats must be positive and their quaternions not zero.")
        if (arrays["opacities"] < 0).any() or (arrays["opacities"] > 1).any():
            raise ShapeError("Opacities of splats must be between 0 and 1.")
        arrays["quats"] /= lengths
        binding = self.binding
        if binding is not None:
            binding = np.asarray(binding, np.int32)
            if binding.shape != (count,) or (binding < 0).any():
                raise ShapeError(f"SplatCloud.binding must be {count} triangle numbers; got shape {binding.shape}.")
        return replace(self, **arrays, binding=binding)

    def visible(self) -> SplatCloud:
        """The splats that a renderer draws: 3DGS passes over those whose opacity is below 1/255 everywhere."""
        return self.select(self.opacities >= _SEEN)

    def select(self, index: np.ndarray | slice) -> SplatCloud:
        """The splats chosen by a mask [N], by indices or by a range."""
        binding = None if self.binding is None else self.binding[index]
        return replace(
            self,
            means=self.means[index],
            quats=self.quats[index],
            scales=self.scales[index],
            opacities=self.opacities[index],
            sh=self.sh[index],
            binding=binding,
        )

    def flipped(self) -> SplatCloud:
        """Turn by half a turn about x: from y up to y down and back, [x, y, z] -> [x, -y, -z]."""
        return replace(
            self,
            means=self.means * _FLIP_POSITION,
            quats=self.quats * _FLIP_QUATERNION,
            sh=self.sh * _FLIP_SH[: self.sh.shape[1], None],
        )


def check_expansion(path: Path, kind: str, count: int, terms: int, file_bytes: int) -> None:
    """Refuse a small file that claims a large cloud before anything is allocated.

    Args:
        path: The file.
        kind: What it was taken for.
        count: Splats that it claims.
        terms: Harmonics of each, the constant one included.
        file_bytes: Size of the file.

    Raises:
        FileFormatError: The cloud would be larger than half a GiB and than any packing could make of such a file.
    """
    needed = count * (_PLAIN_BYTES + 12 * terms)
    if needed > max(_ANY_SIZE, _MOST_PACKED * file_bytes):
        raise bad_file(path, kind, f"its {count} splats would take {needed} bytes, from a file of {file_bytes}")


def finish_reading(path: Path, kind: str, cloud: SplatCloud) -> SplatCloud:
    """Drop splats with values that are not finite or without extent, normalise, and say what was dropped.

    Raises:
        FileFormatError: No usable splat is left.
    """
    count = cloud.count
    if count == 0:
        raise bad_file(path, kind, "it has no splats")
    with np.errstate(over="ignore", invalid="ignore"):
        # A sum is finite only where all its terms are; it needs one pass and no mask of the full size.
        total = cloud.means.sum(1, dtype=np.float64) + cloud.sh.reshape(count, -1).sum(1, dtype=np.float64) + cloud.opacities
        lengths = np.linalg.norm(cloud.quats, axis=1)
        good = np.isfinite(total) & np.isfinite(lengths) & (lengths > _MIN_QUATERNION)
        good &= ((cloud.scales > 0) & (cloud.scales < _MAX_SCALE)).all(1)
    if not good.all():
        dropped = count - int(good.sum())
        if dropped == count:
            raise bad_file(path, kind, "none of its splats has finite values")
        cloud = cloud.select(good)
        cloud.warnings.append(f"{dropped} of {count} splats had values that are not finite and were left out.")
        lengths = lengths[good]
    cloud.quats = (cloud.quats / lengths[:, None]).astype(np.float32)
    cloud.opacities = np.clip(cloud.opacities, 0.0, 1.0)
    return cloud


def clipped_colors(cloud: SplatCloud, low: float, high: float) -> list[str]:
    """One sentence where a format that keeps constant colors from `low` to `high` cuts some of them off, else none."""
    colors = cloud.colors()
    count = int(((colors < low - _HALF_STEP) | (colors > high + _HALF_STEP)).any(1).sum())
    return [f"{count} of {cloud.count} splats have colors beyond what the format holds; these were clipped."] if count else []


def lost_harmonics(cloud: SplatCloud) -> list[str]:
    """One sentence where a format without view dependence drops some, else none."""
    return ["The format holds no view dependence; it was left out."] if (cloud.sh[:, 1:] != 0).any() else []


def logit(opacities: np.ndarray) -> np.ndarray:
    """Inverse of `sigmoid`, finite for 0 and 1. [...] float32."""
    clipped = np.clip(opacities.astype(np.float64), _MIN_OPACITY, 1.0 - _MIN_OPACITY)
    return np.log(clipped / (1.0 - clipped)).astype(np.float32)


def sigmoid(values: np.ndarray) -> np.ndarray:
    """Opacity of a logit, [...] float32; NaN stays NaN."""
    with np.errstate(over="ignore", invalid="ignore"):
        return (1.0 / (1.0 + np.exp(-values.astype(np.float32)))).astype(np.float32)


def exp_scale(values: np.ndarray) -> np.ndarray:
    """Linear scale of a logarithm, [...] float32; what overflows becomes infinite and is dropped later."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.exp(values.astype(np.float32))


def log_scale(values: np.ndarray) -> np.ndarray:
    """Natural logarithm of a linear scale, [...] float32, finite."""
    return np.log(np.clip(values, _MIN_SCALE, _MAX_SCALE)).astype(np.float32)
