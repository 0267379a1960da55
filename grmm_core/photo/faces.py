"""Find faces in a photo: box, 478 landmarks, 52 ARKit coefficients.

The networks are MediaPipe's face detector, face landmarks and blendshapes (`networks`); the steps between them (anchors,
weighted non-maximum suppression, rotated regions) follow its published graphs. Two things are added: the picture is searched
in tiles when nothing is found at once, or only faces so small that others beside them may be missed, because the detector sees
only 128 pixels, and a face counts only when the landmark network says that one is present, because the detector alone accepts
cats.

Coordinates are pixels of the picture given, x right, y down; the subject's left side is on the right of the picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..controls.names import ARKIT_NAMES
from ..errors import NoFaceError
from .landmarks import EYE_CORNERS, LANDMARK_COUNT
from .networks import load_networks

DETECTOR_SIZE = 128
LANDMARK_SIZE = 256
MIN_DETECTION_SCORE = 0.5
MIN_PRESENCE = 0.5
SUPPRESSION_OVERLAP = 0.3
REGION_SCALE = 1.5  # the landmark network's region relative to the face's box
SCORE_CLIP = 100.0
TILE_LEVELS = (2, 4, 8, 16)  # tiles across the longer side that are tried after the whole picture
TILE_OVERLAP = 0.34
SMALL_FACE = 0.2  # of a tile's side: where faces of this size are seen, the detector misses others
MIN_REGION = 24.0  # pixels; below this the landmark network guesses

# The detector's anchors (strides of its two output grids, anchors in each cell).
_ANCHOR_GRIDS = ((16, 2), (8, 6))
# The landmarks that the blendshape network was trained on.
_BLENDSHAPE_LANDMARKS = (
    0, 1, 4, 5, 6, 7, 8, 10, 13, 14, 17, 21, 33, 37, 39, 40, 46, 52, 53, 54, 55, 58, 61, 63, 65, 66, 67, 70, 78, 80, 81, 82,
    84, 87, 88, 91, 93, 95, 103, 105, 107, 109, 127, 132, 133, 136, 144, 145, 146, 148, 149, 150, 152, 153, 154, 155, 157,
    158, 159, 160, 161, 162, 163, 168, 172, 173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249, 251, 263, 267, 269, 270,
    276, 282, 283, 284, 285, 288, 291, 293, 295, 296, 297, 300, 308, 310, 311, 312, 314, 317, 318, 321, 323, 324, 332, 334,
    336, 338, 356, 361, 362, 365, 373, 374, 375, 377, 378, 379, 380, 381, 382, 384, 385, 386, 387, 388, 389, 390, 397, 398,
    400, 402, 405, 409, 415, 454, 466, 468, 469, 470, 471, 472, 473, 474, 475, 476, 477,
)  # fmt: skip


@dataclass(frozen=True)
class Detection:
    """A candidate of the detector.

    Attributes:
        box: Left, top, right, bottom in pixels, [4].
        keypoints: Right eye, left eye, nose tip, mouth, right and left ear of the subject, [6, 2] pixels.
        score: 0..1.
    """

    box: np.ndarray
    keypoints: np.ndarray
    score: float


@dataclass(frozen=True)
class Face:
    """A face with its landmarks.

    Attributes:
        landmarks: x and y in pixels and relative depth in the same unit (smaller is nearer), [478, 3]; the last ten are the
            irises.
        arkit: Coefficients of the 52 ARKit shapes, 0..1 (tongueOut is always 0), [52]. A start value, no measurement.
        presence: The landmark network's confidence that this is a face, 0..1.
        score: The detector's, 0..1.
        box: Left, top, right, bottom of the landmarks, [4] pixels.
    """

    landmarks: np.ndarray
    arkit: np.ndarray
    presence: float
    score: float
    box: np.ndarray

    @property
    def eye_distance(self) -> float:
        """Distance of the outer eye corners in pixels."""
        right, left = self.landmarks[list(EYE_CORNERS), :2]
        return float(np.linalg.norm(left - right))


@dataclass(frozen=True)
class Region:
    """The square of a picture that a landmark network sees.

    Attributes:
        center: Pixels, [2].
        side: Pixels.
        angle: How far it is turned with the head, radians.
    """

    center: np.ndarray
    side: float
    angle: float

    @staticmethod
    def around(points: np.ndarray) -> Region:
        """Of a face whose landmarks are known, [478, 2 or 3] pixels."""
        center, size, angle = _extent(points)
        return Region(center, max(float(max(size)) * REGION_SCALE, MIN_REGION), angle)

    def cut(self, pixels: Tensor) -> Tensor:
        """What it shows of a picture [1, 3, H, W], [1, 3, `LANDMARK_SIZE`, `LANDMARK_SIZE`]."""
        return _sample(pixels, self.center, self.side, self.angle, LANDMARK_SIZE)

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Points of the cut in the picture, [N, 2]."""
        return _rotate(points * (self.side / LANDMARK_SIZE) - self.side / 2.0, self.angle) + self.center

    def within(self, points: np.ndarray) -> np.ndarray:
        """Points of the picture in the cut, [N, 2]."""
        return (_rotate(points - self.center, -self.angle) + self.side / 2.0) * (LANDMARK_SIZE / self.side)


def find_faces(image: np.ndarray, levels: int | None = None) -> list[Face]:
    """Return the faces of a photo, the largest first.

    Args:
        image: [H, W, 3] uint8 or float 0..1, display sRGB.
        levels: How many levels are searched at most: the whole picture, then those of `TILE_LEVELS`; None for all.

    Raises:
        NoFaceError: None was found; the message says what to try.
    """
    pixels = to_pixels(image)
    faces: list[Face] = []
    for windows in _search_levels(pixels.shape[3], pixels.shape[2])[:levels]:
        detections = _suppress([d for window in windows for d in _detect(pixels, *window)])
        for detection in detections:
            face = locate_landmarks(pixels, detection)
            if face.presence >= MIN_PRESENCE and not any(_overlap(face.box, f.box) > SUPPRESSION_OVERLAP for f in faces):
                faces.append(face)
        if faces and min(np.ptp(face.box.reshape(2, 2), axis=0).max() for face in faces) > SMALL_FACE * windows[0][2]:
            break
    if not faces:
        raise NoFaceError("No face was found in the photo; use one where the whole face is visible, upright and sharp.")
    return sorted(faces, key=lambda face: -float(face.box[2] - face.box[0]))


def locate_landmarks(pixels: Tensor, detection: Detection) -> Face:
    """Run the landmark network on a detection, once more on the region that its own landmarks give.

    Args:
        pixels: [1, 3, H, W] float 0..1.
        detection: Where to look.
    """
    right_eye, left_eye = detection.keypoints[0], detection.keypoints[1]
    angle = math.atan2(left_eye[1] - right_eye[1], left_eye[0] - right_eye[0])
    center = (detection.box[:2] + detection.box[2:]) / 2.0
    side = float(max(detection.box[2:] - detection.box[:2])) * REGION_SCALE
    points, presence = _landmarks_in(pixels, Region(center, max(side, MIN_REGION), angle))
    if presence >= MIN_PRESENCE and float(max(_extent(points)[1])) > MIN_REGION / REGION_SCALE:
        points, presence = _landmarks_in(pixels, Region.around(points))
    return _face(pixels, points, presence, detection.score)


def follow_face(pixels: Tensor, face: Face) -> Face:
    """Find a face again near where it was, as in the next frame of a video; its `presence` says whether it is still there.

    Args:
        pixels: [1, 3, H, W] float 0..1.
        face: As it was found before.
    """
    points, presence = _landmarks_in(pixels, Region.around(face.landmarks))
    return _face(pixels, points, presence, face.score)


def landmarks_near(pixels: Tensor, points: np.ndarray) -> np.ndarray:
    """The landmarks of a face that lies about where points [478, 2 or 3] are, [478, 3] as of `Face`."""
    return _landmarks_in(pixels, Region.around(points))[0]


def _extent(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Centre [2] and size [2] of the upright box around landmarks, and how far it is turned."""
    right, left = points[EYE_CORNERS[0], :2], points[EYE_CORNERS[1], :2]
    angle = math.atan2(left[1] - right[1], left[0] - right[0])
    low, high = _extent_along(points[:, :2], angle)
    return _rotate((low + high) / 2.0, angle), high - low, angle


def _face(pixels: Tensor, points: np.ndarray, presence: float, score: float) -> Face:
    box = np.concatenate([points[:, :2].min(0), points[:, :2].max(0)])
    size = np.array([pixels.shape[3], pixels.shape[2]], np.float32)
    return Face(points, _coefficients(points[:, :2], size), presence, score, box)


def to_pixels(image: np.ndarray) -> Tensor:
    """A picture [H, W, 3], uint8 or float 0..1, as [1, 3, H, W] float 0..1."""
    pixels = torch.tensor(np.ascontiguousarray(image))
    pixels = pixels.float() / 255.0 if pixels.dtype == torch.uint8 else pixels.float()
    return pixels.permute(2, 0, 1)[None].contiguous()


def _search_levels(width: int, height: int) -> list[list[tuple[float, float, float]]]:
    """Square windows (left, top, side): the whole picture first, then ever smaller overlapping tiles."""
    side = float(max(width, height))
    levels = [[((width - side) / 2.0, (height - side) / 2.0, side)]]
    for count in TILE_LEVELS:
        tile = side / count * (1.0 + TILE_OVERLAP)
        if tile < DETECTOR_SIZE:
            break
        columns, rows = (max(1, math.ceil((extent - tile) / (tile / (1.0 + TILE_OVERLAP))) + 1) for extent in (width, height))
        xs = np.linspace(0.0, max(width - tile, 0.0), columns) if columns > 1 else [(width - tile) / 2.0]
        ys = np.linspace(0.0, max(height - tile, 0.0), rows) if rows > 1 else [(height - tile) / 2.0]
        levels.append([(float(x), float(y), tile) for y in ys for x in xs])
    return levels


@lru_cache(maxsize=1)
def _anchors() -> np.ndarray:
    """Centres of the detector's 896 anchors in units of its input, [896, 2]."""
    centers = []
    for cells, repeat in _ANCHOR_GRIDS:
        y, x = np.mgrid[0:cells, 0:cells]
        grid = np.stack([(x.ravel() + 0.5) / cells, (y.ravel() + 0.5) / cells], axis=1)
        centers.append(np.repeat(grid, repeat, axis=0))
    return np.concatenate(centers)


def _detect(pixels: Tensor, left: float, top: float, side: float) -> list[Detection]:
    """Run the detector on one square window."""
    center = np.array([left + side / 2.0, top + side / 2.0])
    crop = _sample(pixels, center, side, 0.0, DETECTOR_SIZE) * 2.0 - 1.0
    boxes, logits = load_networks()["face_detector"](crop.permute(0, 2, 3, 1))
    scores = torch.sigmoid(logits.reshape(-1).clamp(-SCORE_CLIP, SCORE_CLIP)).numpy()
    keep = scores >= MIN_DETECTION_SCORE
    values = boxes.reshape(-1, 8, 2).numpy()[keep] / DETECTOR_SIZE  # centre, size, six keypoints
    values[:, 0] += _anchors()[keep]
    values[:, 2:] += _anchors()[keep][:, None]
    origin = np.array([left, top])
    result = []
    for value, score in zip(values, scores[keep], strict=True):
        middle, half = value[0] * side + origin, value[1] * side / 2.0
        result.append(Detection(np.concatenate([middle - half, middle + half]), value[2:] * side + origin, float(score)))
    return result


def _suppress(detections: list[Detection]) -> list[Detection]:
    """Weighted non-maximum suppression: overlapping candidates are averaged by their scores."""
    remaining = sorted(detections, key=lambda d: -d.score)
    result = []
    while remaining:
        best = remaining[0]
        cluster = [d for d in remaining if _overlap(best.box, d.box) > SUPPRESSION_OVERLAP] or [best]
        remaining = [d for d in remaining if all(d is not c for c in cluster)]
        weights = np.array([d.score for d in cluster])
        weights /= weights.sum()
        box = np.einsum("n,nk->k", weights, np.stack([d.box for d in cluster]))
        keypoints = np.einsum("n,nkc->kc", weights, np.stack([d.keypoints for d in cluster]))
        result.append(Detection(box, keypoints, best.score))
    return result


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two boxes."""
    size = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    shared = float(np.prod(np.maximum(size, 0.0)))
    union = float(np.prod(np.maximum(a[2:] - a[:2], 0.0)) + np.prod(np.maximum(b[2:] - b[:2], 0.0))) - shared
    return shared / union if union > 0.0 else 0.0


def _landmarks_in(pixels: Tensor, region: Region) -> tuple[np.ndarray, float]:
    raw, presence, _ = load_networks()["face_landmarks_detector"](region.cut(pixels).permute(0, 2, 3, 1))
    points = raw.reshape(LANDMARK_COUNT, 3).numpy().astype(np.float64)
    result = np.concatenate([region.placed(points[:, :2]), points[:, 2:] * (region.side / LANDMARK_SIZE)], axis=1)
    return result.astype(np.float32), float(torch.sigmoid(presence.reshape(())))


def _coefficients(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The blendshape network's output in the order of `ARKIT_NAMES`; its first value is a neutral score."""
    subset = torch.from_numpy(points[list(_BLENDSHAPE_LANDMARKS)].astype(np.float32))[None]
    (values,) = load_networks()["face_blendshapes"](subset)
    result = np.zeros(len(ARKIT_NAMES), np.float32)
    result[: values.numel() - 1] = values.reshape(-1)[1:].numpy()
    return result


def _rotate(points: np.ndarray, angle: float) -> np.ndarray:
    """Turn [..., 2] by `angle` radians (clockwise in a picture, where y points down)."""
    c, s = math.cos(angle), math.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def _extent_along(points: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    turned = _rotate(points, -angle)
    return turned.min(0), turned.max(0)


def _sample(pixels: Tensor, center: np.ndarray, side: float, angle: float, size: int) -> Tensor:
    """Cut a rotated square out of [1, 3, H, W]; black outside. Averages first where the picture is shrunk."""
    factor = max(1, int(side / size))
    if factor > 1:
        pixels = functional.avg_pool2d(pixels, factor, ceil_mode=True, count_include_pad=False)
    height, width = pixels.shape[2:]
    c, s = math.cos(angle), math.sin(angle)
    half = side / factor / 2.0
    x, y = center / factor
    # grid_sample maps -1..1 to the picture's outer edges (align_corners=False)
    theta = torch.tensor([[
        [2.0 * half * c / width, -2.0 * half * s / width, 2.0 * x / width - 1.0],
        [2.0 * half * s / height, 2.0 * half * c / height, 2.0 * y / height - 1.0],
    ]], dtype=torch.float32)  # fmt: skip
    grid = functional.affine_grid(theta, [1, 3, size, size], align_corners=False)
    return functional.grid_sample(pixels, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
