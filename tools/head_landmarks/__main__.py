"""Make the network of the head model's landmarks: pictures of random people, training, the asset.

    python -m tools.head_landmarks make PICTURES --count 100 --seed 1
    python -m tools.head_landmarks make CHECKED --count 6 --seed 2 --held-out
    python -m tools.head_landmarks train PICTURES CHECKED --minutes 60

`make` (several may run, with different seeds) and `train` may run at the same time: training takes in what is there. A file has
some 96 pictures and takes a minute. CHECKED tells how the network errs; its leading modes go into the asset.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

from grmm_core.files.tensorfile import read_tensors
from grmm_core.photo.head_landmarks import ASSET

from ..shards import save_shard
from .photographer import Photographer
from .trainer import SAMPLE, errors_on, save, train

RATE = 4e-4


def main() -> None:
    """Run one of the steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    steps = parser.add_subparsers(dest="step", required=True)
    make = steps.add_parser("make")
    make.add_argument("folder", type=Path)
    make.add_argument("--count", type=int, default=100, help="files")
    make.add_argument("--seed", type=int, default=1)
    make.add_argument("--held-out", action="store_true", help="of other people")
    teach = steps.add_parser("train")
    teach.add_argument("folder", type=Path)
    teach.add_argument("checked", type=Path)
    teach.add_argument("--minutes", type=float, default=60)
    teach.add_argument("--rate", type=float, default=RATE, help="of learning, at most")
    teach.add_argument("--start", type=Path, help="network to go on from")
    teach.add_argument("-o", "--output", type=Path, default=ASSET)
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.step == "make":
        photographer = Photographer(args.held_out)
        args.folder.mkdir(parents=True, exist_ok=True)
        for number in range(args.count):
            path = args.folder / f"shard_{args.seed:02d}{number:04d}.npz"
            if not path.exists():
                save_shard(path, list(photographer.pictures(np.random.default_rng([args.seed, number]))), SAMPLE)
                _say(str(path))
        return
    start = {k: torch.from_numpy(v) for k, v in read_tensors(args.start)[0].items()} if args.start else None
    network = train(args.folder, 60 * args.minutes, args.rate, start, _say)
    errors = errors_on(network, args.checked)
    save(network, errors, args.output)
    _say(f"off by {np.linalg.norm(errors, axis=-1).mean():.4f} eye distances on {len(errors) // 2} pictures of other people")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
