"""`python -m tools.hair_figures DATA...`: how near drawn hair comes to captured people, view by view, in the mask of hair.

People wear the strands that their capture recorded, in colors found in their views (`--held-out`: in one that is not measured):
people of the library on their avatars, others on the mean's skin. Prints a table of PSNR, of the perceptual distance of what
the mask cuts out (MobileNetV2), and of the mean angle between strands where the truth has a clear direction; `--output` takes
truth and picture side by side.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from grmm_core.avatar import load_avatar
from grmm_core.avatar.library import library_names, library_path
from grmm_core.data.dataset import CaptureDataset
from grmm_core.data.types import Shot, View
from grmm_core.evaluation.haired import Haired, turned_degrees
from grmm_core.evaluation.samples import Sample, load, samples
from grmm_core.evaluation.scene import DrawnPerson, Scene
from grmm_core.model.weights_file import weights_path
from grmm_core.pictures.images import quantize, write_png
from grmm_core.session import FINAL_STRANDS
from grmm_core.training.perceptual import load_perceptual

AROUND = 4  # px around the hair that the perceptual distance sees
LEAST = 500  # px of hair, below which a view says nothing


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
    arguments = parser.parse_args()
    datasets = [CaptureDataset(folder) for folder in arguments.data]
    scene, distance = Scene(weights_path()), load_perceptual("mobilenet")
    known, people, rows = people_of_library(scene), {}, []
    shown = samples(datasets)
    source = photos(shown) if arguments.held_out else {}
    haired = Haired(scene, datasets, packed=arguments.packed, strands=1.0 if arguments.views else FINAL_STRANDS)
    try:
        print("| view | drawn on | PSNR, dB | perceptual | direction, degrees |\n|---|---|---|---|---|")
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

            image = haired.draw(people[name], sample.shot, view.camera, seen)
            rows.append(figures(image, view.image, hair, distance))
            where = "library" if name in known else "mean's skin"
            print(f"| {sample.name} | {where} | {rows[-1][0]:.1f} | {rows[-1][1]:.2f} | {rows[-1][2]:.0f} |", flush=True)
            if arguments.output is not None:
                arguments.output.mkdir(parents=True, exist_ok=True)
                pair = np.concatenate([view.image, image], 1)
                write_png(arguments.output / f"{sample.name.replace(' ', '_')}.png", quantize(pair))
    finally:
        haired.close()
    if rows:
        mean = np.nanmean(np.array(rows), 0)
        print(f"| mean | {len(people)} people | {mean[0]:.1f} | {mean[1]:.2f} | {mean[2]:.0f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
