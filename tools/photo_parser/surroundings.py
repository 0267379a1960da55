"""The light on a drawn person and what is behind: shapes, stripes, lamps, noise. Numpy, and torch for blur."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional

from grmm_core.hair.ribbons import AMBIENT, LAMPS
from grmm_core.photo.parser import LABELS, SIZE

from .bare_people import Light
from .drawn import Drawn, Generator, any_color, noise, smooth, unit

_GLOSSY, _STRANDS = ("skin", "ears", "neck", "hat"), ("hair", "brows", "beard")


def lit(drawn: Drawn, light: Light, g: Generator) -> np.ndarray:
    """Replace the rig's light by another; returns linear RGB [S, S, 3].

    Bare skin is as the engine has lit it, and strands on it are in its shadows; layers have normals, and no shadows but a
    random one.
    """
    n = drawn.normals

    def rig(direction: np.ndarray) -> np.ndarray:
        return np.clip(n @ direction, 0, 1)[..., None]

    old = AMBIENT + sum(rig(lamp[:3]) * lamp[3] for lamp in LAMPS.astype(np.float64))
    new = light.ambient * (1 + (n @ light.tilt)[..., None])
    to_eye = -drawn.camera.forward
    shine, sheen = np.zeros_like(new), np.zeros_like(new)
    for towards, color, hard in zip(light.towards, light.colors, light.hard, strict=True):
        new = new + color * (smooth(-0.1, 0.5, n @ towards)[..., None] * 0.9 if hard else rig(towards))
        half = unit(towards + to_eye)
        shine = shine + color * rig(half) ** g.uniform(8, 60) * g.uniform(0, 0.25) * (g.random() < 0.6)
        sheen = sheen + color * rig(towards) * rig(half) ** g.uniform(2, 12) * g.uniform(0, 0.2) * (g.random() < 0.6)
    ratio = new / old
    soft, strands = (np.isin(drawn.labels, [LABELS.index(name) for name in names])[..., None] for names in (_GLOSSY, _STRANDS))
    layers = drawn.color * ratio + shine * soft + sheen * strands
    skin = drawn.bare * drawn.cover > 0.9
    # the engine's light is in other units
    scale = (
        np.median((drawn.color * ratio)[skin].mean(-1)) / max(np.median(drawn.lit[skin].mean(-1)), 1e-4) if skin.any() else 1.0
    )
    scale = np.clip(scale, 0.05, 20.0)
    image = layers + (drawn.lit * scale - layers) * drawn.bare[..., None]
    image = image + (drawn.color * drawn.falling * scale - layers) * drawn.downy[..., None]
    person = drawn.cover > 0.9
    # photos are exposed for the lit side of a face
    level = np.quantile(image.mean(-1)[person], 0.7 if light.side else 0.5) if person.any() else 0.2
    usual = np.median(drawn.color.mean(-1)[person]) if person.any() else 0.2
    wanted = g.uniform(0.12, 0.5) if light.backlit else np.exp(g.normal(0.05, 0.4))
    image = image * np.clip(wanted * usual / max(level, 1e-4), 0.05, 6.0)
    if g.random() < 0.2:  # a shadow's edge
        field = noise(g, len(n), 2, 1)
        image = image * (1 - g.uniform(0.2, 0.7) * smooth(0.0, g.uniform(0.05, 0.6), field))[..., None]
    return image


def background(g: Generator, skin: np.ndarray, hair: np.ndarray) -> np.ndarray:
    """Walls, lights, stripes, shelves: linear RGB [S, S, 3]."""
    size = SIZE
    rows, columns = np.mgrid[:size, :size] / size
    image = np.broadcast_to(any_color(g, skin, hair), (size, size, 3)).astype(np.float64)
    turn = g.uniform(0, 2 * np.pi)
    ramp = smooth(0, 1, 0.5 + (columns - 0.5) * np.cos(turn) + (rows - 0.5) * np.sin(turn))[..., None]
    image = image + (any_color(g, skin, hair) - image) * ramp * g.random()
    if g.random() < 0.25:
        return np.clip(image * (1 + 0.2 * g.random() * noise(g, size)[..., None]), 0, 1)
    for _ in range(int(g.integers(1, 9))):
        color, kind = any_color(g, skin, hair), g.random()
        x, y = g.random(2)
        turn = g.normal(0, 0.3) if g.random() < 0.7 else g.uniform(0, np.pi)
        u = (columns - x) * np.cos(turn) + (rows - y) * np.sin(turn)
        v = (rows - y) * np.cos(turn) - (columns - x) * np.sin(turn)
        w, h = g.uniform(0.02, 0.4, 2)
        if kind < 0.35:
            cover = (np.abs(u) < w) & (np.abs(v) < h * 2)
        elif kind < 0.6:
            cover = (u / w) ** 2 + (v / h) ** 2 < 1
        elif kind < 0.8:
            cover = (np.sin(u * 6.28 / g.uniform(0.03, 0.25)) > g.uniform(-0.5, 0.7)) & (np.abs(u) < 0.4) & (np.abs(v) < 0.6)
        else:
            cover = noise(g, size, 5, int(g.integers(1, 8))) > g.uniform(0.1, 0.8)
        image = np.where(cover[..., None], color * (1 + 0.3 * noise(g, size, 4, 4)[..., None]), image)
    if g.random() < 0.15:  # lamps
        for _ in range(int(g.integers(1, 12))):
            x, y = g.random(2)
            spot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / g.uniform(0.01, 0.05) ** 2)
            image = image + spot[..., None] * np.exp(g.normal(0, 0.1, 3)) * g.uniform(0.5, 2)
    return np.clip(image, 0, 1.5)


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur of [S, S, C]."""
    reach = int(np.ceil(2.5 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights = torch.from_numpy(kernel / kernel.sum()).float()
    planes = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[:, None]
    planes = functional.conv2d(functional.pad(planes, (reach, reach, 0, 0), mode="replicate"), weights.reshape(1, 1, 1, -1))
    planes = functional.conv2d(functional.pad(planes, (0, 0, reach, reach), mode="replicate"), weights.reshape(1, 1, -1, 1))
    return planes[:, 0].permute(1, 2, 0).numpy()
