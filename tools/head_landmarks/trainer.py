"""Train the landmark network on the files that `photographer` makes, and measure it on others."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from grmm_core.files.tensorfile import write_tensors
from grmm_core.head import load_open_head
from grmm_core.photo.faces import LANDMARK_COUNT, LANDMARK_SIZE
from grmm_core.photo.head_landmarks import ASSET, EYE_DISTANCE, FORMAT, PROGRAM, SIGMAS, VERSION
from grmm_core.photo.networks import load_program

from ..landmark_noise import leading_modes, mirror_of
from ..photo_parser.drawn import Generator
from ..shards import Shards
from .make_up import made_up

SAMPLE = "crop", "truth"  # what a file holds of each picture
BATCH = 16
AVERAGED = 0.995  # share of the running mean of weights that a step keeps
FROZEN = 6  # first convolutions, which keep what they learned from photos
WARM = 100  # steps until the rate is whole
START_SIGMA = -3.5
DECAY = 1e-4
MODES = 16
COVERED, COARSE = 0.15, 0.2  # share of pictures with a thing before the face, and of those of fewer pixels


class LandmarkNetwork(nn.Module):
    """MediaPipe's landmark network with weights that can be trained; its third number is the logarithm of an error."""

    def __init__(self, start: dict[str, Tensor] | None = None) -> None:
        super().__init__()
        self.program = load_program(PROGRAM, {})
        self.numbers, convolutions, self.values = list[int](), 0, nn.ParameterList()
        for step in self.program.operators:
            for number in step["in"]:
                value = self.program.weights.get(number)
                if value is None or not value.is_floating_point() or number in self.numbers:
                    continue
                convolutions += step["op"] == "CONV_2D" and value.ndim > 1
                self.numbers.append(number)
                self.values.append(nn.Parameter(value.clone(), requires_grad=convolutions > FROZEN))
        if start is not None:
            for number, value in zip(self.numbers, self.values, strict=True):
                value.data.copy_(start[str(number)])
            return
        last = next(step for step in self.program.operators if step["out"] == self.program.outputs[0])
        with torch.no_grad():  # depth, which is not asked for, becomes the error
            weight, bias = (self.values[self.numbers.index(number)] for number in last["in"][1:3])
            weight.view(LANDMARK_COUNT, 3, -1)[:, 2], bias.view(LANDMARK_COUNT, 3)[:, 2] = 0.0, START_SIGMA

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Points of [B, 3, S, S], pixels, [B, 478, 2]; logarithms of their expected errors in eye distances, [B, 478]."""
        weights = dict(zip(self.numbers, self.values, strict=True))
        raw = self.program.first_output(pictures.permute(0, 2, 3, 1), weights).reshape(len(pictures), LANDMARK_COUNT, 3)
        return raw[..., :2], raw[..., 2].clamp(*SIGMAS)


def batch(shards: Shards, numbers: np.ndarray, g: Generator | None = None) -> tuple[Tensor, np.ndarray]:
    """Pictures [B, 3, S, S], 0..1, some of them made up where `g` draws that, and landmarks, pixels, [B, 478, 2]."""
    pictures, points = shards.stacked("crop", numbers) / np.float32(255), shards.stacked("truth", numbers)
    if g is not None:
        pictures = np.stack([made_up(*shown, g) for shown in zip(pictures, points, strict=True)])
    return torch.from_numpy(pictures).permute(0, 3, 1, 2), points


def varied(pictures: Tensor, points: np.ndarray, mirror: np.ndarray, g: Generator) -> tuple[Tensor, np.ndarray]:
    """Mirror pictures, move and turn them a little, vary their colors, cover and coarsen some."""
    count, half = len(pictures), LANDMARK_SIZE / 2

    def each(values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.asarray(values)).float().view(count, -1, 1, 1)

    turned = g.random(count) < 0.5
    pictures = torch.where(torch.from_numpy(turned).view(-1, 1, 1, 1), pictures.flip(3), pictures)
    points = np.where(turned[:, None, None], points[:, mirror] * [-1.0, 1.0] + [LANDMARK_SIZE, 0.0], points)
    angle, scale, shift = g.normal(0, 0.05, count), np.exp(g.normal(0, 0.04, count)), g.normal(0, 0.015, (count, 2))
    c, s = np.cos(angle) * scale, np.sin(angle) * scale
    turn = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
    grid = functional.affine_grid(
        torch.from_numpy(np.concatenate([turn, shift[..., None]], 2)).float(), list(pictures.shape), align_corners=False
    )
    image = functional.grid_sample(pictures, grid, align_corners=False)
    points = np.einsum("nij,nkj->nki", np.linalg.inv(turn), points / half - 1.0 - shift[:, None]) * half + half
    image = image.clamp(1e-3, 1) ** each(np.exp(g.normal(0, 0.2, count))) * each(np.exp(g.normal(0, 0.12, (count, 3))))
    grey = image.mean(1, keepdim=True)
    image = grey + (image - grey) * each(np.where(g.random(count) < 0.15, 0.0, np.exp(g.normal(0, 0.3, count))))
    image = 0.5 + (image - 0.5) * each(np.exp(g.normal(0, 0.15, count))) + each(g.normal(0, 0.05, count))
    for number in range(count):
        if g.random() < COVERED:
            thing = image[int(g.integers(count))].roll(tuple(g.integers(LANDMARK_SIZE, size=2).tolist()), (1, 2))
            if g.random() < 0.5:
                thing = torch.from_numpy(g.random(3)).float().view(3, 1, 1).expand_as(thing)
            image[number] = torch.where(torch.from_numpy(_patch(g)), thing, image[number])
        if g.random() < COARSE:
            small = functional.interpolate(
                image[number][None], scale_factor=float(g.uniform(0.35, 0.9)), mode="bilinear", antialias=True
            )
            image[number] = functional.interpolate(small, size=(LANDMARK_SIZE, LANDMARK_SIZE), mode="bilinear")[0]
    return (image + each(0.06 * g.random(count) ** 3) * torch.randn_like(image)).clamp(0, 1), points


def _patch(g: Generator) -> np.ndarray:
    """An ellipse or a bar, [S, S] bool."""
    rows, columns = np.mgrid[:LANDMARK_SIZE, :LANDMARK_SIZE]
    x, y = g.uniform(20, LANDMARK_SIZE - 20, 2)
    width, height = g.uniform(12, 60, 2)
    turn = g.uniform(0, np.pi)
    u, v = (columns - x) * np.cos(turn) + (rows - y) * np.sin(turn), (rows - y) * np.cos(turn) - (columns - x) * np.sin(turn)
    round_ = (u / width) ** 2 + (v / height) ** 2 < 1
    return round_ if g.random() < 0.5 else (np.abs(u) < width) & (np.abs(v) < height)


def train(
    folder: Path, seconds: float, rate: float, start: dict[str, Tensor] | None, report: Callable[[str], None]
) -> LandmarkNetwork:
    """Train for a while on a folder's files, which may grow meanwhile.

    The loss is the negative logarithm of a Gaussian's likelihood, with an error of its own for each landmark (Wood et al.).

    Args:
        folder: Of `shard_0000.npz` and so on.
        seconds: How long; the rate follows a cosine over it.
        rate: Of learning, at most.
        start: Weights to begin with; None for those that MediaPipe trained.
        report: Called with a line of progress.
    """
    g, mirror, shards = np.random.default_rng(5), mirror_of(load_open_head()), Shards(folder, SAMPLE)
    torch.manual_seed(5)
    network = LandmarkNetwork(start)
    trained = [value for value in network.values if value.requires_grad]
    optimizer = torch.optim.AdamW(trained, rate, weight_decay=DECAY)
    mean = [value.detach().clone() for value in trained]
    began, step, errors = time.monotonic(), 0, []
    while (share := (time.monotonic() - began) / seconds) < 1:
        if step % 100 == 0:
            count = shards.refresh()
        for group in optimizer.param_groups:
            group["lr"] = rate * (0.5 + 0.5 * np.cos(np.pi * share)) * min(1.0, (step + 1) / WARM)
        pictures, truth = varied(*batch(shards, g.integers(count, size=BATCH), g), mirror, g)
        points, sigma = network(pictures)
        squares = (((points - torch.from_numpy(truth).float()) / EYE_DISTANCE) ** 2).sum(-1)
        loss = (2 * sigma + squares * torch.exp(-2 * sigma) / 2).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(trained, 1.0)
        optimizer.step()
        step += 1
        kept = min(AVERAGED, step / (step + 10))
        for average, value in zip(mean, trained, strict=True):
            average.mul_(kept).add_(value.detach(), alpha=1 - kept)
        errors.append(float(squares.detach().sqrt().mean()))
        if step % 100 == 0:
            report(f"{step} steps, {count} pictures, {100 * share:.0f} %, off by {np.mean(errors[-100:]):.4f} eye distances")
    for average, value in zip(mean, trained, strict=True):
        value.data.copy_(average)
    return network


def errors_on(network: LandmarkNetwork, folder: Path) -> np.ndarray:
    """Landmarks found less true ones over a folder's pictures and their mirror images, eye distances, [N, 478, 2].

    Without their mean, since a shift is the camera's.
    """
    shards, mirror, result = Shards(folder, SAMPLE), mirror_of(load_open_head()), []
    for number in range(shards.refresh()):
        picture, truth = batch(shards, np.array([number]))
        with torch.no_grad():
            own, other = (network(seen)[0][0].numpy() for seen in (picture, picture.flip(3)))
        found = (own + other[mirror] * [-1.0, 1.0] + [LANDMARK_SIZE, 0.0]) / 2
        error = (found - truth[0]) / EYE_DISTANCE
        result.append(error - error.mean(0))
    errors = np.stack(result)
    return np.concatenate([errors, errors[:, mirror] * [-1.0, 1.0]])


def save(network: LandmarkNetwork, errors: np.ndarray, path: Path = ASSET) -> None:
    """Write the asset: weights, mirrored landmarks, and the leading modes of the errors [N, 478, 2]."""
    modes, held = leading_modes(errors, MODES)
    tensors = {
        str(number): value.detach().numpy().astype(np.float16)
        for number, value in zip(network.numbers, network.values, strict=True)
    }
    tensors |= {"mirror": mirror_of(load_open_head()).astype(np.int32), "modes": modes.astype(np.float16)}
    write_tensors(path, tensors, {"format": FORMAT, "version": VERSION, "held": f"{held:.3f}"})
