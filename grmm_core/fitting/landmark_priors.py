"""What is known before a photo is looked at closely: how exact each landmark is, and how likely expressions and cameras are.

The figures were measured on pictures of synthetic people with known parameters (errors of the landmark network against the
projected truth, in units of the distance of the outer eye corners), rounded, and loosened where real photos differ.
Used by the stages. Needs numpy only.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..controls.names import ARKIT_NAMES
from ..errors import FileFormatError
from ..files.tensorfile import read_tensors
from ..head.head_model import JOINT_COUNT, HeadModel
from .point_rig import LandmarkRig
from .types import LANDMARK_COUNT

# MediaPipe's indices. The rest of the skin has no feature to hold on to and is spread from these by the network.
FACE_OVAL = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150, 136, 172,
    58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip
LIPS = (
    61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0, 267, 269, 270, 409, 78, 95, 88, 178, 87, 14, 317,
    402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415,
)  # fmt: skip
# Upper and lower lip opposite each other, from the middle outwards: inner border, outer border.
_INNER_LIP_PAIRS = ((13, 14), (82, 87), (81, 178), (80, 88), (191, 95), (312, 317), (311, 402), (310, 318), (415, 324))
_OUTER_LIP_PAIRS = ((0, 17), (37, 84), (39, 181), (40, 91), (185, 146), (267, 314), (269, 405), (270, 321), (409, 375))
INNER_LIPS = tuple(index for pair in _INNER_LIP_PAIRS for index in pair)
EYES = (
    263, 249, 390, 373, 374, 380, 381, 382, 362, 466, 388, 387, 386, 385, 384, 398,
    33, 7, 163, 144, 145, 153, 154, 155, 133, 246, 161, 160, 159, 158, 157, 173,
)  # fmt: skip
BROWS = (276, 283, 282, 295, 285, 300, 293, 334, 296, 336, 46, 53, 52, 65, 55, 70, 63, 105, 66, 107)
IRISES = tuple(range(468, 478))
NOSE = (1, 2, 98, 327, 4, 5, 195, 197, 6, 168)
# What remains of the errors beside the modes of `landmark_modes`, in eye distances.
_GROUP_SIGMA = (
    (FACE_OVAL, 0.035), (LIPS, 0.018), (INNER_LIPS, 0.008), (EYES, 0.015), (BROWS, 0.03), (IRISES, 0.02), (NOSE, 0.03),
)  # fmt: skip
_SKIN_SIGMA = 0.03
_FACING_FULL, _FACING_NONE, _HIDDEN_FACTOR = 0.35, -0.25, 4.0

_ASSETS = Path(__file__).resolve().parent.parent / "assets"
NOISE_ASSET, PLACED_ASSET = _ASSETS / "landmark_noise.safetensors", _ASSETS / "head_landmarks.safetensors"
# of the modes' standard deviation: the network errs less on photos, which it was trained on, than on synthetic pictures
NOISE_SHARE = 0.5
# of that where the shape is known: what a photo's own unknowns take over wrongly is seen in that photo only
VIEW_NOISE = 0.2
# likewise of the landmarks of `photo.head_landmarks`, and how much of a point's expected error is not in their modes
PLACED_NOISE, PLACED_SHARE = 0.2, 0.7

# How far the reported coefficients are believed: mean of the prior = factor * reported.
_START_FACTORS = {
    "browInnerUp": 0.3, "browOuterUp": 0.3, "browDown": 0.3, "eyeSquint": 0.4, "eyeLook": 0.5, "mouthPucker": 0.5,
    "mouthShrug": 0.3, "mouthStretch": 0.5, "mouthPress": 0.5,
}  # fmt: skip
_START_FACTOR = 0.85
_ARKIT_SIGMA = 0.2
_ARKIT_SIGMAS = {
    "jawForward": 0.05, "jawLeft": 0.1, "jawRight": 0.1, "cheekPuff": 0.1, "tongueOut": 0.02, "mouthClose": 0.08,
    "mouthLeft": 0.12, "mouthRight": 0.12, "browOuterUp": 0.15, "browInnerUp": 0.15,
}  # fmt: skip
# Where the shape is looked for: of what the network does not report, and how much more of what it does. Expressions have no
# negative strengths, so that their errors do not cancel out: faces at rest with the errors of above had jaws open by 0.12, and
# shapes were too short, and their mouths too narrow, by as much.
_SHAPE_SIGMA, _SHAPE_SLOPE = 0.05, 0.3
_BY_LANDMARKS = ("eye", "brow")  # of these landmarks tell more than the network
# In smiles of photos the lower lip is unrolled by so much of the smile: the model's thins it by a fifth, people's do not.
_UNROLLED, _UNROLLS = "mouthRollLower", 0.5
_EXTRA_SIGMA = 0.05  # components beside the ARKit shapes: they repeat these, and animators have no slider for them
_STATISTICAL_SIGMA = 0.7  # heads whose components are standard deviations (FLAME)
_HIGH = 1.1

_JAW, _EYES = 2, (3, 4)
_JAW_SIGMA = (0.03, 0.015, 0.005)  # radians, beside what jawOpen and its kin turn
_FREE_JAW_SIGMA = (0.15, 0.04, 0.02)  # where no expression component turns the jaw
_EYE_SIGMA = (0.2, 0.3, 0.0)
FULL_FRAME = 36.0  # millimetres, longer side of the film that focal lengths are compared on
_USUAL_FOCAL = 50.0  # millimetres
_FOCAL_SIGMA, _STATED_FOCAL_SIGMA = 1.0, 0.12  # of the logarithm; a stated one may belong to an uncropped photo
_USUAL_DISTANCE, _DISTANCE_SIGMA = 1.3, 0.4  # metres, of the logarithm


@dataclass
class View:
    """The unknowns of one photo.

    Attributes:
        rotation: Head to camera, [3, 3].
        offset: Projection of the face's centre from the picture's centre, pixels, [2].
        magnification: Logarithm of depth over focal length (metres per pixel).
        focal: Logarithm of the focal length in pixels.
        expression: [E].
        pose: Control angles in radians, [5, 3].
        noise: Strength of the landmark network's error modes, standard deviations, [K].
    """

    rotation: np.ndarray
    offset: np.ndarray
    magnification: float
    focal: float
    expression: np.ndarray
    pose: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True)
class Priors:
    """Gaussian priors and bounds of one photo's unknowns.

    Attributes:
        expression_mean, expression_sigma, expression_low, expression_high: [E].
        pose_mean, pose_sigma: Control angles in radians, [5, 3]; a sigma of 0 fixes an angle.
        focal, focal_sigma: Logarithm of the focal length in pixels.
        distance, distance_sigma: Logarithm of the camera's distance in metres.
    """

    expression_mean: np.ndarray
    expression_sigma: np.ndarray
    expression_low: np.ndarray
    expression_high: np.ndarray
    pose_mean: np.ndarray
    pose_sigma: np.ndarray
    focal: float
    focal_sigma: float
    distance: float = float(np.log(_USUAL_DISTANCE))
    distance_sigma: float = _DISTANCE_SIGMA

    def log_focal(self, magnification: float) -> float:
        """Likeliest logarithm of the focal length for a known logarithm of depth over focal length."""
        a, b = self.focal_sigma**-2, self.distance_sigma**-2
        return float((a * self.focal + b * (self.distance - magnification)) / (a + b))

    def value(self, view: View) -> float:
        """Twice the negative logarithm of the prior density up to a constant: the sum of squared standard scores."""
        free = self.pose_sigma > 0.0
        return float(
            (((view.expression - self.expression_mean) / self.expression_sigma) ** 2).sum()
            + (((view.pose - self.pose_mean)[free] / self.pose_sigma[free]) ** 2).sum()
            + ((view.focal - self.focal) / self.focal_sigma) ** 2
            + ((view.magnification + view.focal - self.distance) / self.distance_sigma) ** 2
        )

    def quadratic(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and half gradient of `value` by [rotation 3, offset 2, magnification, focal, expression E, angles 15]."""
        size = 7 + len(self.expression_mean) + JOINT_COUNT * 3
        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        sigma = self.pose_sigma.reshape(-1)
        precision = np.where(sigma > 0.0, 1.0 / np.maximum(sigma, 1e-9) ** 2, 0.0)
        diagonal = np.concatenate([np.zeros(7), self.expression_sigma**-2.0, precision])
        matrix[np.arange(size), np.arange(size)] = diagonal
        gradient[7:] = diagonal[7:] * np.concatenate(
            [view.expression - self.expression_mean, (view.pose - self.pose_mean).reshape(-1)]
        )
        distance = self.distance_sigma**-2
        matrix[5:7, 5:7] += distance
        matrix[6, 6] += self.focal_sigma**-2
        gradient[5:7] += distance * (view.magnification + view.focal - self.distance)
        gradient[6] += (view.focal - self.focal) * self.focal_sigma**-2
        return matrix, gradient


def make_priors(head: HeadModel, arkit: np.ndarray, focal: float | None, width: int, height: int) -> Priors:
    """Priors of one photo.

    Args:
        head: Head model.
        arkit: Reported ARKit coefficients, [52].
        focal: Focal length in pixels that the file states, or None.
        width: Photo size in pixels.
        height: Likewise.
    """
    start = np.array([_by_name(_START_FACTORS, name, _START_FACTOR) for name in ARKIT_NAMES]) * np.clip(arkit, 0.0, 1.0)
    start = np.nan_to_num(start)
    mean = start @ head.arkit_to_expression.astype(np.float64)  # [E]
    names = head.expression_names
    if set(names) & set(ARKIT_NAMES):
        known = np.array([name in ARKIT_NAMES for name in names])
        sigma = np.array([_by_name(_ARKIT_SIGMAS, name, _ARKIT_SIGMA) for name in names])
        sigma = np.where(known, sigma, _EXTRA_SIGMA)
        low, high = np.where(known, 0.0, -_EXTRA_SIGMA * 3), np.where(known, _HIGH, _EXTRA_SIGMA * 3)
        mean = np.where(known, mean, 0.0)
    else:
        sigma = np.full(len(names), _STATISTICAL_SIGMA)
        low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    pose_mean = np.einsum("k,kjx->jx", start, head.arkit_pose.astype(np.float64))
    pose_sigma = np.zeros((JOINT_COUNT, 3))
    turned = bool(np.abs(head.expression_pose[:, _JAW]).max() > 0.0)
    pose_sigma[_JAW] = _JAW_SIGMA if turned else _FREE_JAW_SIGMA
    pose_sigma[list(_EYES)] = _EYE_SIGMA
    usual = _USUAL_FOCAL / FULL_FRAME * max(width, height)
    return Priors(
        mean, sigma, low, high, pose_mean, pose_sigma,
        float(np.log(usual if focal is None else focal)), _FOCAL_SIGMA if focal is None else _STATED_FOCAL_SIGMA,
    )  # fmt: skip


def photo_priors(head: HeadModel, priors: Priors) -> Priors:
    """Priors of `make_priors` for a photo, whose expression need not be one of sliders: lower lips unroll as far as it smiles.

    Heads whose components are not the ARKit shapes keep theirs.
    """
    names = head.expression_names
    if _UNROLLED not in names:
        return priors
    mean, low, row = priors.expression_mean.copy(), priors.expression_low.copy(), names.index(_UNROLLED)
    mean[row] -= _UNROLLS * mean[[names.index(f"mouthSmile{side}") for side in ("Left", "Right")]].mean()
    low[row] = -_UNROLLS * _HIGH
    return replace(priors, expression_mean=mean, expression_low=low)


def shape_priors(head: HeadModel, priors: Priors, arkit: np.ndarray) -> Priors:
    """Priors of `make_priors` for looking for the shape: mouth, jaw and cheeks are nearly as reported, [52].

    Heads whose components are not the ARKit shapes keep theirs.
    """
    sigma = priors.expression_sigma.copy()
    for index, name in enumerate(head.expression_names):
        if name in ARKIT_NAMES and not name.startswith(_BY_LANDMARKS):
            reported = float(np.nan_to_num(arkit[ARKIT_NAMES.index(name)]))
            sigma[index] = min(sigma[index], _SHAPE_SIGMA + _SHAPE_SLOPE * min(max(reported, 0.0), 1.0))
    return replace(priors, expression_sigma=sigma)


def landmark_sigmas(rig: LandmarkRig, rotation: np.ndarray) -> np.ndarray:
    """Expected error of each landmark in eye distances; larger where the face turns away from the camera.

    Args:
        rig: Landmarks of the head model.
        rotation: Head to camera, [3, 3].

    Returns:
        [478].
    """
    sigma = np.full(LANDMARK_COUNT, _SKIN_SIGMA)
    for group, value in _GROUP_SIGMA:
        sigma[list(group)] = value
    hidden = np.clip((_FACING_FULL - rig.facing(rotation)) / (_FACING_FULL - _FACING_NONE), 0.0, 1.0)
    return sigma * (1.0 + (_HIDDEN_FACTOR - 1.0) * hidden)


def landmark_modes(rotation: np.ndarray, placed: bool = False) -> np.ndarray:
    """How the landmark network errs: directions in which all landmarks move together, one standard deviation each.

    Args:
        rotation: Head to camera, [3, 3]; the modes roll with the head.
        placed: Of landmarks that `photo.head_landmarks` found.

    Returns:
        Eye distances, [478, 2, K].
    """
    roll = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(roll), np.sin(roll)
    share = PLACED_NOISE if placed else NOISE_SHARE
    return np.einsum("ij,klj->lik", np.array([[c, -s], [s, c]]), _stored_modes(placed)) * share


@functools.lru_cache(maxsize=2)
def _stored_modes(placed: bool) -> np.ndarray:
    """Modes of an asset, [K, 478, 2], read once, without what opens and closes the lips in them.

    On synthetic pictures the network errs in how far lips are open. On photos it finds the lips' borders within a pixel or two;
    taken as an error, a smile that shows teeth was tracked with lips nearly shut, and the teeth were painted on the lower lip.
    """
    asset = PLACED_ASSET if placed else NOISE_ASSET
    modes = read_tensors(asset)[0].get("modes")
    if modes is None or modes.ndim != 3 or modes.shape[1:] != (LANDMARK_COUNT, 2):
        raise FileFormatError(f"{asset} is damaged; install the program again.")
    modes = modes.astype(np.float64)
    pairs = np.array([*_INNER_LIP_PAIRS, *_OUTER_LIP_PAIRS])
    modes[:, pairs] = modes[:, pairs].mean(2, keepdims=True)
    modes.flags.writeable = False
    return modes


def _by_name(table: dict[str, float], name: str, default: float) -> float:
    """Value of the longest key that `name` begins with."""
    keys = [key for key in table if name.startswith(key)]
    return table[max(keys, key=len)] if keys else default
