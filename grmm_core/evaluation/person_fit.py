"""A held-out person's codes from one captured view, whose head parameters are known exactly.

By `fitting.invert` as users get it (eq. 19 and 20), or by a short search of the codes alone (eq. 19) that needs nothing but the
model. Both see one picture; shape, expression, pose, camera and the picture's labels are the capture's, so that errors of
tracking and of the parser stay out of the figures (the monocular protocol has them in). Used by `protocols`.
"""

from __future__ import annotations

import dataclasses
import logging
import tempfile
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..controls.frame import ALIGNED_TO_ARKIT
from ..data.layers import PARTS
from ..data.types import Shot
from ..fitting.types import LANDMARK_COUNT, PhotoTrack
from ..geometry.camera import Camera
from ..head import HeadModel
from ..jobs.progress import Reporter, Share, within
from ..jobs.stages import FIT
from ..photo.parser import LABELS
from ..pictures.images import quantize, write_png
from ..training.losses import LossWeights, reconstruction_loss
from ..training.views import View, crop_to_person, shrink
from .samples import LoadedView, Sample
from .scene import DrawnPerson, Scene

logger = logging.getLogger(__name__)

CODES = "codes"
METHODS = (CODES, "fast", "standard", "high")
"""`CODES` is the search of this module, the others are presets of the fitting."""
STEPS = 120
RATE = 0.04  # of Adam, for codes of about unit size
PRIOR = 2e-4
MARGIN = 8  # pixels around the person
FIT_SIZE = 384  # pixels
_WEIGHTS = LossWeights()
_GREY = 0.5
_LABEL_OF = {"lashes": "eyes", "teeth": "mouth"}  # parts of the studio that the parser calls otherwise
_TRACKED_SHARE = 0.1  # of the time, for the progress


def fit_person(scene: Scene, sample: Sample, view: LoadedView, shape: np.ndarray, method: str, report: Share) -> DrawnPerson:
    """Fit a person.

    Args:
        scene: Model.
        sample: The view.
        view: Its picture.
        shape: Shape coefficients of the person, [S].
        method: One of `METHODS`.
        report: Hears how much is done.

    Raises:
        GrmmError: As the fitting does.
    """
    if method == CODES or not scene.residuals:  # without residual codes there is nothing to search
        return search_codes(scene, sample, view, shape, report)
    return _inverted(scene, exact_track(scene.head, sample, view, shape), sample.shot.subject, method, report)


def fit_photo(scene: Scene, sample: Sample, view: LoadedView, method: str, report: Share) -> tuple[DrawnPerson, PhotoTrack]:
    """Fit a person as users do: from the picture alone, tracked by `fitting.track`.

    Args:
        scene: Model.
        sample: The view.
        view: Its picture.
        method: One of `METHODS` but not `CODES`.
        report: Hears how much is done.

    Returns:
        The person, and what the tracking found.

    Raises:
        NoFaceError: No face is found in the picture.
    """
    from ..fitting.pixel_stage import track_pixels
    from ..fitting.track import track_photos

    with tempfile.TemporaryDirectory(prefix="grmm-evaluate-") as folder:
        path = Path(folder) / "photo.png"
        write_png(path, quantize(view.image + (1.0 - view.mask[..., None]) * _GREY))
        tracks = track_photos([path], scene.head, masks=[view.mask])
    (track,) = track_pixels(tracks, scene.model, scene.info)
    return _inverted(scene, track, sample.shot.subject, method, within(report, _TRACKED_SHARE, 1.0)), track


def track_shot(sample: Sample, track: PhotoTrack, head: HeadModel) -> Shot:
    """A tracked photo as a shot of the evaluation; its aligned weights are those of the capture."""
    pose = head.pose_of(track.expression, track.pose)
    return dataclasses.replace(sample.shot, expression=track.expression, pose=pose)


def _inverted(scene: Scene, track: PhotoTrack, name: str, method: str, report: Share) -> DrawnPerson:
    from ..fitting.invert import invert

    stages = Reporter(FIT.only(("codes", "decoders")), lambda progress: report(progress.fraction))
    return scene.from_avatar(invert([track], scene.model, scene.head, method, info=scene.info, name=name, report=stages))


def exact_track(head: HeadModel, sample: Sample, view: LoadedView, shape: np.ndarray) -> PhotoTrack:
    """What perfect tracking and labels would find in a captured view."""
    shot = sample.shot
    alpha = view.mask[..., None]
    vertices = head.vertices(shape, shot.expression, shot.pose)
    landmarks = projected(head.landmark_positions(vertices, LANDMARK_COUNT), view.camera)
    return PhotoTrack(
        source=sample.name, image=view.image + (1.0 - alpha) * _GREY, mask=view.mask, valid=np.ones_like(view.mask),
        camera=view.camera, photo_camera=view.camera, shape=shape, expression=shot.expression,
        pose=shot.pose - head.pose_of(shot.expression), landmarks=landmarks, landmarks_fitted=landmarks,
        arkit=np.clip(shot.aligned @ ALIGNED_TO_ARKIT, 0.0, 1.0), labels=known_labels(sample, view),
    )  # fmt: skip


def known_labels(sample: Sample, view: LoadedView) -> np.ndarray | None:
    """What a captured view shows in each pixel, as `PhotoTrack.labels`; None where the capture does not say.

    The studio's skin is the parser's skin, ears, lips and neck in one: nothing else tells them apart after tracking.
    """
    parts = sample.parts(max(view.mask.shape))
    if parts is None or parts.shape[1:] != view.mask.shape:
        return None
    labels = np.zeros((len(LABELS), *view.mask.shape), np.float32)
    labels[LABELS.index("background")] = 1.0 - view.mask
    for name, cover in zip(PARTS, parts, strict=True):
        labels[LABELS.index(_LABEL_OF.get(name, name))] += cover
    return labels


def projected(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels [N, 2] of points [N, 3] in head space."""
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    z = np.ones(len(local)) if camera.orthographic else local[:, 2]
    return np.stack([camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy], -1)


def search_codes(scene: Scene, sample: Sample, view: LoadedView, shape: np.ndarray, report: Share) -> DrawnPerson:
    """Search z_id and the offset of z_exp that draw a view best (eq. 19), from the training people's mean.

    Args:
        scene: Model.
        sample: The view.
        view: Its picture.
        shape: Shape coefficients, [S].
        report: Hears how much is done.
    """
    start = scene.made(sample.shot.subject, scene.mean_code, shape)
    if not scene.residuals:
        return start
    target = _fit_view(sample, view)
    image, mask = scene.tensor(target.image) / 255.0, scene.tensor(target.mask) / 255.0
    base = scene.model.tensors(scene.inputs(start, sample.shot))
    spread = _spread(scene)
    step_id, offset = torch.zeros_like(base.z_id), torch.zeros_like(base.z_exp)
    parameters = [step_id.requires_grad_(), offset.requires_grad_()]
    optimiser = torch.optim.Adam(parameters, lr=RATE, betas=(0.9, 0.99))
    background = np.random.default_rng(0)
    for step in range(STEPS):
        for group in optimiser.param_groups:
            group["lr"] = RATE * 0.5 * (1.0 + float(np.cos(np.pi * step / STEPS)))
        color = scene.tensor(background.random(3))
        inputs = dataclasses.replace(base, z_id=base.z_id + step_id * spread, z_exp=base.z_exp + offset)
        rendering = scene.model.render(target.camera, inputs, color, backend=scene.backend)
        truth = image + (1.0 - mask)[..., None] * color
        pictures = (rendering.image, rendering.raw)
        loss = torch.stack([reconstruction_loss(picture, truth, _WEIGHTS) for picture in pictures]).sum()
        loss = loss + PRIOR * (step_id.square().mean() + offset.square().mean())
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        report((step + 1) / STEPS)
    logger.info("%s: loss %.4f after %d steps", sample.name, float(loss.detach()), STEPS)
    z_id, z_exp = ((base.z_id + step_id * spread), offset)
    return dataclasses.replace(start, z_id=z_id.detach().cpu().numpy(), z_exp=z_exp.detach().cpu().numpy())


def _fit_view(sample: Sample, view: LoadedView) -> View:
    """The view cut to the person and not larger than needed."""
    image, mask = (np.round(array * 255.0).astype(np.uint8) for array in (view.image, view.mask))
    shot = sample.shot
    whole = View(0, sample.name, view.camera, image, mask, view.depth, shot.aligned, shot.expression, shot.pose)
    return crop_to_person(shrink(whole, FIT_SIZE), MARGIN)


def _spread(scene: Scene) -> Tensor:
    """Standard deviation of the training people's codes, [Z]: how far a step of 1 goes."""
    codes = scene.info.z_id
    if len(codes) < 2:
        return scene.tensor(np.ones_like(scene.mean_code))
    return scene.tensor(codes.std(0)).clamp(min=1e-3)
