"""A picture of a run's curves, from the numbers that the trainer logs: the loss, and what held-out views say.

    python -m grmm_core.training.metric_plots RUN/metrics.jsonl ... -o curves.png

draws the runs that followed one another side by side, as one. Used by `trainer` beside its previews. Needs Pillow.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from ..errors import FileFormatError, GrmmError
from ..files.access import read_bytes
from ..pictures.images import write_png

WIDTH, PANEL, MARGIN = 900, 260, 56
SMOOTHED = 400  # steps in a running mean
_INK, _FAINT, _GRID = (30, 30, 30), (200, 208, 222), (228, 228, 228)
COLORS = ((31, 90, 180), (196, 78, 32), (40, 140, 70))
HELD_OUT = {"val_psnr_mask": "in the mask", "val_psnr": "whole frame", "val_psnr_raw": "whole frame, unrefined"}


@dataclass(frozen=True)
class Curve:
    """Points of one line.

    Attributes:
        name: For the legend.
        x, y: Equal lengths.
        dots: Mark the points.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    dots: bool = False


def read_metrics(path: Path) -> list[dict[str, float]]:
    """Rows of a metrics file.

    Raises:
        FileAccessError: It is missing or cannot be read.
        FileFormatError: It has no line, or one that is not an object of numbers with a step.
    """
    rows = []
    for line in read_bytes(path).decode("utf-8", "replace").splitlines():
        try:
            row = {str(name): float(value) for name, value in json.loads(line).items()}
            rows.append(row | {"step": row["step"], "loss": row["loss"]})
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise FileFormatError(f"{path} is not a metrics file of grmm train; choose RUN/metrics.jsonl.") from error
    if not rows:
        raise FileFormatError(f"{path} holds no steps; choose a run that has done some.")
    return rows


def write_curves(runs: Sequence[Sequence[dict[str, float]]], path: Path) -> None:
    """Draw loss and held-out PSNR over the steps of runs that followed one another.

    Args:
        runs: Rows of each, in order.
        path: PNG file, written whole.

    Raises:
        FileAccessError: It cannot be written.
    """
    rows, borders, first = [], [], 0.0
    for run in runs:
        rows += [row | {"step": row["step"] + first} for row in run]
        first = rows[-1]["step"] if rows else first
        borders.append(first)
    steps, losses = (np.array([row[name] for row in rows]) for name in ("step", "loss"))
    window = min(SMOOTHED, max(1, len(losses) // 4))
    mean = np.convolve(losses, np.ones(window) / window, "valid")
    loss = Curve(f"mean of {window} steps", steps[window - 1 :], mean)
    held_out = []
    for name, title in HELD_OUT.items():
        known = [(row["step"], row[name]) for row in rows if math.isfinite(row.get(name, math.nan))]
        if known:
            at, decibels = np.array(known).T
            held_out.append(Curve(title, at, decibels, dots=True))
    picture = Image.new("RGB", (WIDTH, 2 * PANEL if held_out else PANEL), "white")
    _panel(picture, 0, "loss (eq. 15 and 17)", [loss], borders[:-1])
    if held_out:
        _panel(picture, PANEL, "PSNR of held-out views, dB", held_out, borders[:-1])
    write_png(path, np.asarray(picture))


def _panel(picture: Image.Image, top: int, title: str, curves: Sequence[Curve], borders: Sequence[float]) -> None:
    draw = ImageDraw.Draw(picture)
    right = max(float(c.x.max()) for c in curves)
    values = np.concatenate([c.y for c in curves])
    low, high = float(values.min()), float(values.max())
    pad = 0.08 * (high - low) or 0.5
    low, high = low - pad, high + pad

    def place(x: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
        across = MARGIN + x / max(right, 1.0) * (WIDTH - MARGIN - 16)
        down = top + PANEL - 28 - (np.clip(y, low, high) - low) / (high - low) * (PANEL - 56)
        return list(zip(across.tolist(), down.tolist(), strict=True))

    for tick in _ticks(low, high):
        ends = place(np.array([0.0, right]), np.full(2, tick))
        draw.line(ends, fill=_GRID)
        draw.text((4, ends[0][1] - 6), f"{tick:g}", fill=_INK)
    for tick in _ticks(0.0, right):
        (x, _), *_ = place(np.array([tick]), np.array([low]))
        draw.text((x - 12, top + PANEL - 24), f"{tick:g}", fill=_INK)
    for border in borders:
        draw.line(place(np.full(2, border), np.array([low, high])), fill=_FAINT, width=2)
    for number, (curve, color) in enumerate(zip(curves, COLORS, strict=False)):
        points = place(curve.x, curve.y)
        draw.line(points, fill=color, width=2)
        for x, y in points if curve.dots else ():
            draw.ellipse((x - 3, y - 3, x + 3, y + 3), fill=color)
        draw.text((WIDTH // 3 + 170 * number, top + 6), curve.name, fill=color)
    draw.text((MARGIN, top + 6), title, fill=_INK)
    draw.text((WIDTH - 44, top + PANEL - 12), "step", fill=_INK)


def _ticks(low: float, high: float) -> np.ndarray:
    """Round numbers between two values, eleven at most."""
    decade = 10.0 ** math.floor(math.log10(max(high - low, 1e-9)))
    step = next(s for s in (decade / 5, decade / 2, decade, 2 * decade) if (high - low) / s <= 10)
    return np.round(np.arange(math.ceil(low / step), math.floor(high / step) + 1) * step, 10)


def main() -> None:
    """Draw the files named on the command line."""
    parser = argparse.ArgumentParser(description="Draw the curves of training runs that followed one another.")
    parser.add_argument("metrics", nargs="+", type=Path, help="metrics.jsonl of each run")
    parser.add_argument("-o", "--output", type=Path, required=True, help="PNG file")
    arguments = parser.parse_args()
    try:
        write_curves([read_metrics(path) for path in arguments.metrics], arguments.output)
    except GrmmError as error:
        raise SystemExit(f"curves: {error}") from None


if __name__ == "__main__":
    main()
