"""Make the photo parser of the package: pictures of random people, training, the asset.

    python -m tools.photo_parser make PICTURES --count 4000 --seed 1
    python -m tools.photo_parser make CHECKED --count 200 --seed 2 --held-out
    python -m tools.photo_parser train PICTURES --minutes 60 --check CHECKED
    python -m tools.photo_parser compare tests/data/photo_parts.json PHOTO... --tracks TRACKS -o sheet.png
    python -m tools.photo_parser worn tests/data/photos_worn.json PHOTO... --tracks TRACKS

`make` and `train` may run at the same time: training takes in what is there.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

from grmm_core.files.tensorfile import read_tensors
from grmm_core.head import load_open_head
from grmm_core.photo.parser_network import ASSET, ParserNetwork

from ..shards import save_shard
from .checking import compare, worn
from .samples import Maker
from .training import SAMPLE, overlaps, save_network, train

SHARD = 40  # samples in a file; grooms change as often


def main() -> None:
    """Run one of the steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    steps = parser.add_subparsers(dest="step", required=True)
    make = steps.add_parser("make")
    make.add_argument("folder", type=Path)
    make.add_argument("--count", type=int, default=4000)
    make.add_argument("--seed", type=int, default=1)
    make.add_argument("--held-out", action="store_true", help="of other people")
    teach = steps.add_parser("train")
    teach.add_argument("folder", type=Path)
    teach.add_argument("--minutes", type=float, default=60)
    teach.add_argument("--seed", type=int, default=1)
    teach.add_argument("--rate", type=float, default=2e-3, help="of learning, at first")
    teach.add_argument("--check", type=Path, help="folder of samples to measure on")
    teach.add_argument("--start", type=Path, help="network to go on from")
    teach.add_argument("-o", "--output", type=Path, default=ASSET)
    check = steps.add_parser("compare", help="with masks drawn over photos")
    check.add_argument("drawn", type=Path)
    check.add_argument("photos", type=Path, nargs="+")
    check.add_argument("--tracks", type=Path, required=True, help="folder where tracked photos are kept")
    check.add_argument("-o", "--output", type=Path, required=True, help="PNG")
    wear = steps.add_parser("worn", help="beards, glasses and hats in photos of which they are known")
    wear.add_argument("known", type=Path)
    wear.add_argument("photos", type=Path, nargs="+")
    wear.add_argument("--tracks", type=Path, required=True, help="folder where tracked photos are kept")
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.step == "make":
        _make(args)
        return
    if args.step == "worn":
        for name, counts in worn(args.photos, args.known, args.tracks, load_open_head()).items():
            _say(f"{name:8}" + ", ".join(f"{kind} {count}" for kind, count in counts.items()))
        return
    if args.step == "compare":
        figures = compare(args.photos, args.drawn, args.tracks, load_open_head(), args.output)
        for photo, shares in figures.items():
            _say(f"{photo:32}" + "  ".join(f"{group} {share:.2f}" for group, share in shares.items()))
        return
    start = {k: torch.from_numpy(v).float() for k, v in read_tensors(args.start)[0].items()} if args.start else None

    def keep(network: ParserNetwork) -> None:
        save_network(network, args.output, {"seed": str(args.seed), "minutes": f"{args.minutes:g}"})

    network = train(args.folder, 60 * args.minutes, args.seed, _say, keep, args.rate, start)
    keep(network)
    if args.check:
        _say("  ".join(f"{name} {value:.2f}" for name, value in overlaps(network, args.check).items()))


def _make(args: argparse.Namespace) -> None:
    maker = Maker(load_open_head(), args.held_out)
    args.folder.mkdir(parents=True, exist_ok=True)
    for shard in range(-(-args.count // SHARD)):
        path = args.folder / f"shard_{shard:04d}.npz"
        if path.exists():
            continue
        g = np.random.default_rng([args.seed, shard])
        maker.refresh(g, 3, 3)
        save_shard(path, [maker.make(g) for _ in range(SHARD)], SAMPLE)
        _say(str(path))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
