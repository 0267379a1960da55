"""What a performance is: the type that all readers return and all writers and processing steps take.

Used by every module of this package, the Blender importer and the command line. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..controls.frame import Controls
from ..controls.names import ALIGNED_NAMES, ARKIT_NAMES, JOINT_NAMES
from ..errors import ShapeError

_ROTATIONS = ("head_rotation", "neck_rotation", "jaw_rotation", "left_eye_rotation", "right_eye_rotation")


@dataclass
class Performance:
    """A recorded performance of T frames. Rotations are XYZ Euler angles in radians in head axes, R = Rz Ry Rx.

    Attributes:
        times: Seconds from the start of the recording, increasing, [T] float64.
        weights: ARKit weights in the order of `expressions.ARKIT_NAMES`, [T, 52] float32, nominally 0..1.
        fps: Frames per second of the recording; the median rate where frames are irregular.
        source: Format that it came from: "arkit-json", "live-link-csv" or "flame-npz".
        recorded_shapes: ARKit names that the file had; the others are zero.
        head_rotation: Rotation of the whole head, [T, 3], or None.
        neck_rotation, jaw_rotation: Joint rotations of a FLAME track, [T, 3], or None.
        left_eye_rotation, right_eye_rotation: Eye rotations relative to the head, [T, 3], or None. Where `weights` has eyeLook*
            shapes these say the same thing once more: use one of the two (`controls` uses the shapes).
        expression: Expression coefficients of the head model named by `head_model`, [T, E], or None.
        translation: Position of the head in metres, [T, 3], or None.
        shape: Shape coefficients of the person, [S], or None.
        static_offset: Per-vertex offsets of the person in metres, [V, 3], or None.
        head_model: "arkit" for weights, "flame" for `expression` and the joints.
        timecodes: The file's own time codes, or None.
        warnings: Sentences about what was repaired, missing or out of range.
    """

    times: np.ndarray
    weights: np.ndarray
    fps: float
    source: str = ""
    recorded_shapes: tuple[str, ...] = ()
    head_rotation: np.ndarray | None = None
    neck_rotation: np.ndarray | None = None
    jaw_rotation: np.ndarray | None = None
    left_eye_rotation: np.ndarray | None = None
    right_eye_rotation: np.ndarray | None = None
    expression: np.ndarray | None = None
    translation: np.ndarray | None = None
    shape: np.ndarray | None = None
    static_offset: np.ndarray | None = None
    head_model: str = "arkit"
    timecodes: tuple[str, ...] | None = None
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.times = np.asarray(self.times, np.float64)
        self.weights = np.asarray(self.weights, np.float32)
        count = self.times.shape[0] if self.times.ndim == 1 else -1
        if count < 1 or self.weights.shape != (count, len(ARKIT_NAMES)):
            raise ShapeError(
                f"A performance needs times [T] and weights [T, {len(ARKIT_NAMES)}]; "
                f"got {self.times.shape} and {self.weights.shape}."
            )
        for name in self.channel_names():
            if getattr(self, name).shape[0] != count:
                raise ShapeError(f"Performance.{name} has {getattr(self, name).shape[0]} frames; the times have {count}.")

    @property
    def frame_count(self) -> int:
        """Number of frames T."""
        return int(self.times.shape[0])

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return float(self.times[-1] - self.times[0])

    def summary(self) -> dict[str, object]:
        """Facts for people: what `grmm info` shows."""
        width = 0 if self.expression is None else self.expression.shape[1]
        return {
            "frames": self.frame_count,
            "seconds": round(self.duration, 3),
            "frames a second": round(self.fps, 3),
            "ARKit shapes": len(self.recorded_shapes),
            "expression coefficients": width,
            "rotations": [name.removesuffix("_rotation") for name in self.rotation_names()],
        }

    def channel_names(self) -> tuple[str, ...]:
        """Names of the per-frame arrays that are present: `weights`, `head_rotation`, `expression` ..."""
        names = ("weights", *_ROTATIONS, "expression", "translation")
        return tuple(name for name in names if getattr(self, name) is not None)

    def rotation_names(self) -> tuple[str, ...]:
        """Names of the per-frame Euler angles that are present."""
        return tuple(name for name in _ROTATIONS if getattr(self, name) is not None)

    def controls(self, frame: int, head_joint: str | None = None) -> Controls:
        """Return one frame as avatar controls.

        Args:
            frame: 0 .. frame_count - 1.
            head_joint: Joint that takes `head_rotation`; by default the root for FLAME tracks, which also turn the neck, and
                the neck for ARKit recordings.
        """
        head_joint = head_joint or ("root" if self.head_model == "flame" else "neck")
        result = Controls()
        result.aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
        result.aligned[: len(ARKIT_NAMES)] = self.weights[frame]
        pose = result.pose
        targets = {"head_rotation": head_joint, "neck_rotation": "neck", "jaw_rotation": "jaw"}
        if not any(name.startswith("eyeLook") for name in self.recorded_shapes):
            targets |= {"left_eye_rotation": "left_eye", "right_eye_rotation": "right_eye"}
        for name, joint in targets.items():
            angles = getattr(self, name)
            if angles is not None:
                pose[JOINT_NAMES.index(joint)] += np.asarray(angles[frame], np.float32)
        if self.expression is not None:
            result.expression = np.asarray(self.expression[frame], np.float32)
        return result
