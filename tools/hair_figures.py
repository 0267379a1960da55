"""`python -m tools.hair_figures DATA...`: how near drawn hair comes to captured people, view by view, in the mask of hair.

People wear the strands that their capture recorded, in colors found in their views (`--held-out`: in one that is not measured):
people of the library on their avatars, others on the mean's skin. Prints a table of PSNR, of the perceptual distance of what
the mask cuts out (MobileNetV2), and of the mean angle between strands where the truth has a clear direction; `--output` takes
truth and picture side by side. `--lights` measures the views in the other lights of the capture, where hair is lit as a scene
lights it, and says how bright it is and how much its strands stand out.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from grmm_core.avatar import load_avatar
from grmm_core.avatar.library import library_names, library_path
from grmm_core.data.dataset import CaptureDataset
from grmm_core.data.layers import LIGHT_PREFIX
from grmm_core.data.types import Shot, View
from grmm_core.evaluation.haired import Haired, turned_degrees
from grmm_core.evaluation.samples import LoadedView, Sample, load, samples
from grmm_core.evaluation.scene import DrawnPerson, Scene
from grmm_core.model.weights_file import weights_path
from grmm_core.pictures.color import srgb_to_linear
from grmm_core.pictures.images import quantize, write_png
from grmm_core.session import FINAL_STRANDS
from grmm_core.training.perceptual import load_perceptual
from grmm_studio.lights import SETUPS

from .light_truth import lighting_of

AROUND = 4  # px around the hair that the perceptual distance sees
LEAST = 500  # px of hair, below which a view says nothing
TITLES = "brightness over the truth's", "contrast below 0.7 px over the truth's", "to 1.4 px", "to 2.8 px"
BANDS = (0.0, 0.7, 1.4, 2.8)  # px, blurs between which single strands and small locks are


def figures(
    image: np.ndarray, truth: np.ndarray, hair: np.ndarray, distance: torch.nn.Module
) -> tuple[float, float, float]:  # fmt: skip
    """PSNR in dB, perceptual distance and mean angle in degrees of a picture [H, W, 3] where there is hair, 0..1 [H, W]."""
    mask = hair > 0.5
    psnr = -10.0 * float(np.log10(((image - truth)[mask] ** 2).mean()))
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    cut = tuple(slice(max(some[0] - AROUND, 0), some[-1] + AROUND + 1) for some in (rows, columns))
    own, true = (torch.from_numpy(np.ascontiguousarray((part * hair[..., None])[cut], np.float32)) for part in (image, truth))
    with torch.no_grad():
        far = float(distance(own, true))
    return psnr, far, turned_degrees(image, truth, hair)


def contrasts(image: np.ndarray, hair: np.ndarray) -> np.ndarray:
    """Mean linear grey of a display picture [H, W, 3] within hair 0..1 [H, W], and deviations of its `BANDS` over it, [4]."""
    from scipy.ndimage import binary_erosion, gaussian_filter

    grey, inside = srgb_to_linear(image).mean(-1), binary_erosion(hair > 0.95, iterations=3)
    blurs = [gaussian_filter(grey, blur) for blur in BANDS]
    mean = float(grey[inside].mean())
    return np.array([mean, *(float((fine - coarse)[inside].std()) / mean for fine, coarse in pairwise(blurs))])


def people_of_library(scene: Scene) -> dict[str, DrawnPerson]:
    """Avatars of the library by the captured person that each is of, without the hair that the library grew on them anew."""
    found = {}
    for avatar in map(load_avatar, map(library_path, library_names())):
        for name, code in zip(scene.info.people, scene.info.z_id, strict=True):
            if np.array_equal(code, avatar.z_id):
                found[name] = scene.from_avatar(replace(avatar, hair=None))
    return found


def photos(shown: list[Sample]) -> dict[str, Sample]:
    """By person the view that tells the hair's colors: the whole head, nearest to the front, in the first folder of them."""
    found: dict[str, Sample] = {}
    for sample in shown:
        best = found.setdefault(sample.shot.subject, sample)
        if best.dataset is sample.dataset and (sample.close, abs(sample.yaw)) < (best.close, abs(best.yaw)):
            found[sample.shot.subject] = sample
    return found


def main() -> int:
    """Draw, measure and print; returns 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", nargs="+", type=Path, metavar="DATA", help="captures with layers, hair and known strands")
    parser.add_argument("--output", type=Path, help="folder for pictures")
    parser.add_argument("--packed", action="store_true", help="the strands that fit into a .grmm, not all that are recorded")
    parser.add_argument("--views", action="store_true", help="draw as viewports do, with fewer and wider strands")
    parser.add_argument(
        "--held-out", action="store_true", help="colors from one view of each person, the whole head nearest to the front; "
        "only the other views count",
    )  # fmt: skip
    parser.add_argument("--lights", action="store_true", help="measure the views in the other lights of the capture instead")
    arguments = parser.parse_args()
    datasets = [CaptureDataset(folder) for folder in arguments.data]
    scene, distance = Scene(weights_path()), load_perceptual("mobilenet")
    known, people, rows = people_of_library(scene), {}, defaultdict(list)
    shown = samples(datasets)
    source = photos(shown) if arguments.held_out else {}
    haired = Haired(scene, datasets, packed=arguments.packed, strands=1.0 if arguments.views else FINAL_STRANDS)
    titles = "view", "drawn on", "PSNR, dB", "perceptual", "direction, degrees", *(TITLES if arguments.lights else ())
    try:
        print(f"| {' | '.join(titles)} |\n{'|---' * len(titles)}|")
        for sample in shown:
            hair, name = sample.hair(), sample.shot.subject
            photo = source.get(name)
            if hair is None or (hair > 0.5).sum() < LEAST or sample is photo:
                continue
            view = load(sample)
            if name not in people:
                people[name] = known.get(name) or scene.made(name, scene.mean_code, sample.dataset.shape(name))

            def seen(shot: Shot, view: View, photo: Sample | None = photo) -> bool:
                return photo is None or (shot is photo.shot and view is photo.view)

            where = "library" if name in known else "mean's skin"
            for light, truth in truths(sample, view, arguments.lights).items():
                lighting = lighting_of(SETUPS[light]) if light else None
                image = haired.draw(people[name], sample.shot, view.camera, seen, lighting)
                row = [*figures(image, truth, hair, distance)]
                if light:
                    row.extend(contrasts(image, hair) / contrasts(truth, hair))
                rows[light].append(row)
                title = f"{sample.name} {light}".strip()
                print(f"| {title} | {where} | {line(row)} |", flush=True)
                if arguments.output is not None:
                    arguments.output.mkdir(parents=True, exist_ok=True)
                    write_png(arguments.output / f"{title.replace(' ', '_')}.png", quantize(np.concatenate([truth, image], 1)))
    finally:
        haired.close()
    for light, measured in rows.items():
        print(f"| {f'mean {light}'.strip()} | {len(people)} people | {line(np.nanmean(measured, 0))} |")
    if len(rows) > 1:
        print(f"| mean | {len(people)} people | {line(np.nanmean([row for some in rows.values() for row in some], 0))} |")
    return 0


def truths(sample: Sample, view: LoadedView, lights: bool) -> dict[str, np.ndarray]:
    """Pictures of a view over black by the name of the light: that of the capture without a name, or those of its layers."""
    if not lights:
        return {"": view.image}
    names = [layer for layer in sample.view.layers if layer.startswith(LIGHT_PREFIX)]
    return {
        layer.removeprefix(LIGHT_PREFIX): sample.dataset.layer(sample.shot, sample.view, layer) * view.mask[..., None]
        for layer in names
    }


def line(row: Iterable[float]) -> str:
    """Cells of a row."""
    return " | ".join(f"{value:.{digits}f}" for value, digits in zip(row, (1, 3, 1, 2, 2, 2, 2), strict=False))


if __name__ == "__main__":
    sys.exit(main())
