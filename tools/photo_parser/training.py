"""Train the photo parser on the shards that `__main__` makes, and measure it on others."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from grmm_core.files.tensorfile import write_tensors
from grmm_core.photo.parser import INPUTS, LABELS, MESH_PARTS, network_input
from grmm_core.photo.parser_network import FORMAT, VERSION, ParserNetwork

from ..shards import Shards
from .samples import IGNORED

SAMPLE = "picture", "mesh", "labels"  # what a file holds of each
BATCH = 8
DECAY = 1e-4
PASTED = 0.25  # share of the samples that get another picture as their background
TONED = 0.4  # share in which a label has another tone, and less or more of its texture
# by how much, of the logarithm: what hats, hair and cloth look like is told by where they are and by their outlines
REPAINTED = {"hair": 0.5, "hat": 0.7, "clothes": 0.7, "beard": 0.35, "neck": 0.25}
AVERAGED = 0.99  # share of the running mean of weights that a step keeps
MASK = 3  # channel of the person's mask; validity and the mesh's parts follow
STARTS = {"scalp": "hair"}  # labels that parts of the mesh are taken for at first, where not their own
RARE = {"glasses": 2.0, "hat": 1.5, "other": 1.5, "brows": 1.5, "beard": 1.5, "mouth": 1.5, "ears": 1.3, "hair": 1.2}


def batch(shards: Shards, numbers: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
    """Pictures 0..1, meshes, labels."""
    picture, mesh, labels = (torch.from_numpy(shards.stacked(name, numbers)) for name in SAMPLE)
    return picture.float() / 255, mesh.float(), labels.long()


def varied(picture: Tensor, mesh: Tensor, labels: Tensor, g: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Mirror samples, put some before the picture of another, and vary exposure, contrast, color and noise of each."""
    count = len(labels)
    behind = torch.from_numpy(g.random(count) < PASTED).view(-1, 1, 1) & (labels == 0)
    picture = torch.cat([torch.where(behind[:, None], picture[:, :3].roll(1, 0), picture[:, :3]), picture[:, 3:]], 1)
    turned = torch.from_numpy(g.random(count) < 0.5)
    picture, mesh, labels = (torch.where(turned.view(-1, *[1] * (x.ndim - 1)), x.flip(-1), x) for x in (picture, mesh, labels))
    mesh[turned, -1] *= -1

    def each(values: np.ndarray) -> Tensor:
        return torch.from_numpy(values).float().view(count, -1, 1, 1)

    image, valid = picture[:, :3], picture[:, 4:5]
    for name, most in REPAINTED.items():
        there = (labels == LABELS.index(name))[:, None].float()
        mean = (image * there).sum((2, 3), keepdim=True) / there.sum((2, 3), keepdim=True).clamp_min(1.0)
        tone = each(np.exp(g.normal(0, most, (count, 1)))) * each(np.exp(g.normal(0, 0.4 * most, (count, 3))))
        painted = (mean + (image - mean) * each(g.uniform(0.0, 1.3, (count, 1)))) * tone
        there = functional.avg_pool2d(there, 3, 1, 1) * each(g.random((count, 1)) < TONED)
        image = image + (painted - image) * there
    image = image.clamp(1e-3, 1) ** each(np.exp(g.normal(0, 0.25, (count, 1)))) * each(np.exp(g.normal(0, 0.12, (count, 3))))
    grey = image.mean(1, keepdim=True)
    image = grey + (image - grey) * each(np.where(g.random((count, 1)) < 0.1, 0.0, np.exp(g.normal(0, 0.3, (count, 1)))))
    image = 0.5 + (image - 0.5) * each(np.exp(g.normal(0, 0.25, (count, 1)))) + each(g.normal(0, 0.05, (count, 1)))
    noisy = each(0.06 * g.random((count, 1)) ** 3)
    image = torch.where(valid > 0, image + noisy * torch.randn_like(image), torch.full_like(image, 0.5)).clamp(0, 1)
    return torch.cat([image, picture[:, 3:]], 1), mesh, labels


def train(
    folder: Path, seconds: float, seed: int, report: Callable[[str], None], keep: Callable[[ParserNetwork], None],
    rate: float, start: dict[str, Tensor] | None = None,
) -> ParserNetwork:  # fmt: skip
    """Train for a while on a folder's shards.

    Args:
        folder: Of `shard_0000.npz` and so on; new ones are taken in.
        seconds: How long; the learning rate follows a cosine over it.
        seed: Of batches and variations.
        report: Called with a line of progress.
        keep: Called with the network now and then.
        rate: Of learning, at first.
        start: Weights to begin with.
    """
    g = np.random.default_rng(seed)
    torch.manual_seed(seed)
    shards, network = Shards(folder, SAMPLE), ParserNetwork(INPUTS, len(LABELS))
    _first_guess(network)
    if start is not None:
        network.load_state_dict(start, strict=False)
    mean = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(AVERAGED), use_buffers=True
    )
    average: ParserNetwork = mean.module  # type: ignore[assignment]
    weight = torch.tensor([RARE.get(name, 1.0) for name in LABELS])
    optimizer = torch.optim.AdamW(network.parameters(), rate, weight_decay=DECAY)
    began, step, losses = time.monotonic(), 0, []
    while (share := (time.monotonic() - began) / seconds) < 1:
        if step % 50 == 0:
            count = shards.refresh()
        for group in optimizer.param_groups:
            group["lr"] = rate * (0.5 + 0.5 * np.cos(np.pi * share)) * min(1.0, (step + 1) / 30)
        picture, mesh, labels = varied(*batch(shards, g.integers(count, size=BATCH)), g)
        with torch.autocast("cpu", torch.bfloat16):
            logits = network(network_input(picture, mesh).to(memory_format=torch.channels_last))
        loss = functional.cross_entropy(logits.float(), labels, weight, ignore_index=IGNORED)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        mean.update_parameters(network)
        losses.append(float(loss.detach()))
        step += 1
        if step % 100 == 0:
            keep(average)
        if step % 50 == 0:
            report(f"{step} steps, {count} samples, {100 * share:.0f} %, loss {np.mean(losses[-50:]):.3f}")
    return average.eval()


def _first_guess(network: ParserNetwork) -> None:
    """Start with what the mesh and the mask say: the mesh's parts on the person, else background."""
    with torch.no_grad():
        network.head.weight.mul_(0.1)
        network.direct.weight.zero_()
        network.direct.weight[LABELS.index("background"), MASK] = -3.0
        for number, part in enumerate(MESH_PARTS):
            network.direct.weight[LABELS.index(STARTS.get(part, part)), MASK + 2 + number] = 3.0


def overlaps(network: ParserNetwork, folder: Path) -> dict[str, float]:
    """Intersection over union of each label over all samples of a folder."""
    shards = Shards(folder, SAMPLE)
    both, either = np.zeros(len(LABELS)), np.zeros(len(LABELS))
    for numbers in np.array_split(np.arange(count := shards.refresh()), max(1, count // BATCH)):
        picture, mesh, labels = batch(shards, numbers)
        with torch.no_grad():
            found = network(network_input(picture, mesh)).argmax(1)
        seen = labels != IGNORED
        for number in range(len(LABELS)):
            a, b = (found == number) & seen, (labels == number) & seen
            both[number] += float((a & b).sum())
            either[number] += float((a | b).sum())
    return {name: float(both[i] / max(either[i], 1)) for i, name in enumerate(LABELS)}


def save_network(network: ParserNetwork, path: Path, metadata: dict[str, str]) -> None:
    """Write weights: convolutions in half precision, the few numbers of a channel in single."""
    tensors = {
        name: value.detach().numpy().astype(np.float16 if value.ndim == 4 else np.float32)
        for name, value in network.state_dict().items()
        if value.ndim
    }
    write_tensors(path, tensors, {"format": FORMAT, "version": VERSION, **metadata})
