"""Rows of figures to JSON values and tables in Markdown; picture sheets. Used by the command line."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..training.losses import psnr_of
from .fid import FID, frechet_distance
from .regions import REGIONS

if TYPE_CHECKING:
    from .metrics import Errors
    from .protocols import Result, Row

ERROR_GAIN = 4.0
NOTHING = "-"
SHEET_ROWS = 6
GAP = 4  # pixels between the pictures of a sheet
DIRECTIONS = ("front", "side", "back")


def summary(result: Result) -> dict[str, Any]:
    """Means of a protocol as JSON values.

    PSNR and SSIM are means over views; errors by region are pooled over all their pixels, because many views show only a few.
    """
    rows = result.rows
    values: dict[str, Any] = {"views": len(rows), "people": len({row.person.name for row in rows})}
    values["refined"] = _means(row.errors for row in rows) | _fid(rows)
    values["unrefined"] = _means(row.raw for row in rows)
    for variant in rows[0].variants if rows else ():
        values[variant] = _means(row.variants[variant] for row in rows)
    second = [(row.errors, row.ablation) for row in rows if row.ablation is not None]
    if second:
        values["ablation"] = {**_means(other for _, other in second), "views": len(second)}
        values["ablation"]["same views"] = _means(own for own, _ in second)
    values["regions"] = {"refined": _pooled(row.errors for row in rows), "unrefined": _pooled(row.raw for row in rows)}
    groups: dict[str, Callable[[Row], bool]] = {name: partial(_whole_head_from, name) for name in DIRECTIONS}
    groups["close-up"] = lambda row: row.sample.close
    groups["neutral"] = lambda row: row.sample.neutral
    groups["with expression"] = lambda row: not row.sample.neutral
    values["groups"] = {
        name: {"views": len(part), **_pair((row.errors.psnr, row.errors.psnr_mask) for row in part)}
        for name, test in groups.items()
        if (part := [row for row in rows if test(row)])
    }
    if result.source:
        values["fitted from"] = {person: sample.name for person, sample in result.source.items()}
    if result.failures:
        values["failures"] = list(result.failures)
    values["rows"] = [_row(row) for row in rows]
    return values


def _whole_head_from(direction: str, row: Row) -> bool:
    return row.sample.direction == direction and not row.sample.close


def table(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Tables of several protocols' `summary` in Markdown."""
    figures: list[str] = list(_NAMES[:-1]) + sorted({n for s in summaries.values() for n in s["refined"] if n not in _NAMES})
    titles = [_TITLES.get(name, name) for name in figures]
    header = ["protocol", "views", "people", *titles]
    rows = [[name, str(s["views"]), str(s["people"]), *_cells(s["refined"], figures)] for name, s in summaries.items()]
    text = _markdown(header, rows) + "\n\nPSNR in dB by region of the head (refined / unrefined):\n\n"
    regions = [[name, *(_both(s["regions"], region) for region in REGIONS)] for name, s in summaries.items()]
    text += _markdown(["protocol", *REGIONS], regions) + "\n\nPSNR inside the mask in dB (number of views):\n\n"
    names = list(dict.fromkeys(group for s in summaries.values() for group in s["groups"]))
    groups = [[name, *(_group(s["groups"].get(group)) for group in names)] for name, s in summaries.items()]
    text += _markdown(["protocol", *names], groups) + "\n\nAblations, on the same views:\n\n"
    without = [[name, *row] for name, s in summaries.items() for row in _ablations(s, figures)]
    return text + _markdown(["protocol", "picture", "views", *titles], without) + "\n"


def _ablations(values: Mapping[str, Any], figures: Sequence[str]) -> list[list[str]]:
    """Rows of one protocol: the whole model, what is left without a part, and the second model."""
    views = str(values["views"])
    forms = ["unrefined", *(name for name in values if "off" in name)]
    rows = [["whole", views, *_cells(values["refined"], figures)]]
    rows += [[form, views, *_cells(values[form], figures)] for form in forms]
    other = values.get("ablation")
    if other is not None:
        if other["views"] != values["views"]:
            rows.append(["whole", str(other["views"]), *_cells(other["same views"], figures)])
        rows.append(["second model", str(other["views"]), *_cells(other, figures)])
    return rows


def _cells(values: Mapping[str, float], figures: Sequence[str]) -> list[str]:
    return [_db(values[name]) if name.startswith("psnr") else _number(values.get(name)) for name in figures]


_TITLES = {
    "psnr": "PSNR", "psnr_mask": "PSNR in mask", "ssim": "SSIM", "ssim_mask": "SSIM in mask", "rmse": "RMSE",
    "turned": "strands off, degrees",
}  # fmt: skip
_NAMES = ("psnr", "psnr_mask", "ssim", "ssim_mask", "rmse", "rmse_mask")


def sheet(rows: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Join pictures [H, W, 3], values 0..1, in rows and columns with gaps; sizes may differ. Returns uint8."""
    from ..pictures.images import quantize

    height = max(picture.shape[0] for row in rows for picture in row)
    width = max(picture.shape[1] for row in rows for picture in row)
    columns = max(len(row) for row in rows)
    page = np.ones((len(rows) * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), np.float32)
    for i, row in enumerate(rows):
        for j, picture in enumerate(row):
            y, x = i * (height + GAP), j * (width + GAP)
            page[y : y + picture.shape[0], x : x + picture.shape[1]] = np.clip(picture, 0.0, 1.0)
    return quantize(page)


def picked(rows: Sequence[Row], count: int = SHEET_ROWS) -> list[Row]:
    """Rows for a sheet, from the best to the worst PSNR inside the mask, evenly: nothing is hidden."""
    kept = [row for row in rows if row.pictures]
    ranked = sorted(kept, key=lambda row: (math.isnan(row.errors.psnr_mask), -row.errors.psnr_mask))
    return [ranked[i] for i in np.unique(np.linspace(0, len(ranked) - 1, min(count, len(ranked))).round().astype(int))]


def error_map(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Absolute difference of pictures [H, W, 3], times `ERROR_GAIN`."""
    difference: np.ndarray = np.abs(np.clip(image, 0, 1) - np.clip(truth, 0, 1)) * ERROR_GAIN
    return difference


def _row(row: Row) -> dict[str, Any]:
    sample, errors = row.sample, row.errors
    values: dict[str, Any] = {"view": sample.name, "person": row.person.name, "yaw": round(sample.yaw, 1)}
    values |= {"close-up": sample.close, "neutral": sample.neutral}
    values |= {name: getattr(errors, name) for name in _NAMES} | errors.perceptual
    if math.isfinite(errors.turned):
        values["turned"] = errors.turned
    values |= {"unrefined_psnr": row.raw.psnr, "unrefined_psnr_mask": row.raw.psnr_mask}
    values |= {f"{name}: psnr_mask": errors.psnr_mask for name, errors in row.variants.items()}
    if row.ablation is not None:
        values["ablation_psnr_mask"] = row.ablation.psnr_mask
    return values


def _means(errors: Iterable[Errors]) -> dict[str, float]:
    every = list(errors)
    means = {name: _mean(getattr(e, name) for e in every) for name in _NAMES}
    distances = sorted({name for e in every for name in e.perceptual})
    if any(math.isfinite(e.turned) for e in every):
        means["turned"] = _mean(e.turned for e in every)
    return means | {name: _mean(e.perceptual[name] for e in every if name in e.perceptual) for name in distances}


def _fid(rows: Sequence[Row]) -> dict[str, float]:
    pairs = [row.features for row in rows if row.features]
    return {FID: frechet_distance(*(np.array(side) for side in zip(*pairs, strict=True)))} if len(pairs) > 1 else {}


def _pair(pairs: Iterable[tuple[float, float]]) -> dict[str, float]:
    every = list(pairs)
    return {"psnr": _mean(p[0] for p in every), "psnr_mask": _mean(p[1] for p in every)}


def _mean(values: Iterable[float]) -> float:
    finite = [value for value in values if math.isfinite(value)]  # an empty mask, or an exact picture, has no PSNR
    return float(np.mean(finite)) if finite else math.nan


def _pooled(errors: Iterable[Errors]) -> dict[str, dict[str, float]]:
    every = list(errors)
    result: dict[str, dict[str, float]] = {}
    for name in REGIONS:
        parts = [e.regions[name] for e in every if name in e.regions]
        if parts:
            mean = sum(p[0] for p in parts) / sum(p[1] for p in parts)
            result[name] = {"views": len(parts), "psnr": psnr_of(mean), "rmse": math.sqrt(mean)}
    return result


def _markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def _db(value: float | None) -> str:
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.2f}"


def _number(value: float | None) -> str:
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.4f}"


def _both(regions: Mapping[str, Mapping[str, Mapping[str, float]]], name: str) -> str:
    pair = [regions[kind].get(name, {}).get("psnr") for kind in ("refined", "unrefined")]
    return " / ".join(_db(value) for value in pair)


def _group(values: Mapping[str, float] | None) -> str:
    return NOTHING if values is None else f"{_db(values['psnr_mask'])} ({values['views']:.0f})"


def codes_table(figures: Mapping[str, Any]) -> str:
    """Table of `codes.separation` and the smoothness of the strips, in Markdown."""
    rows = [
        [name, f"{f['difference_mm']:.3f}", f"{f['size_mm']:.3f}", f"{f['percent']:.1f} %"]
        for name, f in figures.items()
        if isinstance(f, Mapping) and "percent" in f
    ]
    header = ["expression displacement", "difference between people, mm", "size, mm", "relative"]
    text = f"\n{figures['people']} people, {figures['expressions']} expressions:\n\n" + _markdown(header, rows) + "\n"
    named = [(name, f) for name, f in figures.items() if "interpolation" in name]
    strips = [[name, f"{f['largest step']:.2f}", f"{f['detour']:.2f}"] for name, f in named]
    if strips:
        text += "\n" + _markdown(["strip", "largest step / mean step", "detour"], strips) + "\n"
    return text
