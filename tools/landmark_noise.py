"""Measure how the landmark network errs, and write the leading modes as an asset of the fitting.

    python -m tools.landmark_noise CAPTURE [--modes 16]

CAPTURE is a folder of `grmm capture`: pictures of synthetic people whose head parameters are known. The errors are found minus
projected landmarks, in units of the eye distance, in the picture's axes, without their mean (a shift is the camera's), and each
mirrored too. They lie in few dimensions; the modes are the principal directions of the second moment (not of the variance: a
systematic error counts as uncertainty too), scaled to one standard deviation.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from grmm_core.data.dataset import CaptureDataset
from grmm_core.errors import NoFaceError
from grmm_core.files.tensorfile import write_tensors
from grmm_core.fitting.landmark_priors import NOISE_ASSET
from grmm_core.geometry.rotations import euler_to_matrix
from grmm_core.head.head_model import HeadModel
from grmm_core.head.open_head import load_open_head
from grmm_core.photo.faces import find_faces

MAX_ANGLE = 45.0  # degrees between the face and the camera
GREY = 0.6
EYE_CORNERS = (33, 263)
OUTLIER = 0.3  # eye distances: another face, or a failure


def mirror_of(head: HeadModel) -> np.ndarray:
    """Landmark on the other side of the face, [478]."""
    points = head.landmark_positions(head.v_template, 478)
    distances = np.linalg.norm(points[:, None] * [-1.0, 1.0, 1.0] - points[None], axis=2)
    return distances.argmin(1)


def errors_of(folder: Path, head: HeadModel) -> np.ndarray:
    """Errors in all usable pictures of people who are not held out, [N, 478, 2]."""
    mean = head.landmark_positions(head.v_template, 478)
    eye_distance = float(np.linalg.norm(mean[EYE_CORNERS[1]] - mean[EYE_CORNERS[0]]))
    result = []
    dataset = CaptureDataset(folder)
    for shot, view in dataset.views():
        if shot.subject in dataset.manifest.held_out_people:  # the evaluation measures on them
            continue
        forward = euler_to_matrix(np.asarray(shot.pose[1], np.float64)) @ np.array([0.0, 0.0, 1.0])
        if forward @ view.camera.view_direction(np.zeros(3)) < np.cos(np.radians(MAX_ANGLE)):
            continue
        try:
            face = find_faces(dataset.picture(shot, view).over(GREY))[0]
        except NoFaceError:
            continue
        vertices = head.vertices(dataset.shape(shot.subject), shot.expression, shot.pose)
        truth = head.landmark_positions(vertices, 478).astype(np.float64)
        local, pixels = view.camera.project(truth)
        unit = view.camera.fx * eye_distance / local[:, 2].mean()
        error = (face.landmarks[:, :2] - pixels) / unit
        if np.median(np.linalg.norm(error, axis=1)) < OUTLIER:
            result.append(error - error.mean(0))
    return np.stack(result)


def leading_modes(errors: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Leading modes of errors [N, 478, 2], one deviation each, [count, 478, 2], and their share of the squared error."""
    _, values, directions = np.linalg.svd(errors.reshape(len(errors), -1), full_matrices=False)
    share = float((values[:count] ** 2).sum() / (values**2).sum())
    modes = directions[:count] * (values[:count] / np.sqrt(len(errors)))[:, None]
    return modes.reshape(-1, *errors.shape[1:]), share


def main() -> None:
    """Measure the landmarks on a capture and write the noise model."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--modes", type=int, default=16)
    parser.add_argument("--output", type=Path, default=NOISE_ASSET)
    options = parser.parse_args()
    head = load_open_head()
    errors = errors_of(options.capture, head)
    errors = np.concatenate([errors, errors[:, mirror_of(head)] * [-1.0, 1.0]])
    modes, share = leading_modes(errors, options.modes)
    metadata = {"format": "grmm-landmark-noise", "pictures": str(len(errors) // 2), "share": f"{share:.3f}"}
    write_tensors(options.output, {"modes": modes.astype(np.float16)}, metadata)
    print(f"{len(errors) // 2} pictures; {options.modes} modes hold {share:.1%} of the squared error")


if __name__ == "__main__":
    main()
