"""The network of `parser`: a small U-Net whose finest grid is half the picture's. Imports torch.

Two by two pixels are folded into channels before the first convolution and unfolded after the last, so that most of the work
happens on 64 x 64 cells. `tools/photo_parser` trains it on synthetic pictures only.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..errors import FileFormatError
from ..files.tensorfile import read_tensors

ASSET = Path(__file__).resolve().parent.parent / "assets" / "photo_parser.safetensors"
FORMAT, VERSION = "grmm-photo-parser", "1"
WIDTHS = (32, 48, 64, 96)
FOLD = 2


def _block(inputs: int, outputs: int, stride: int = 1, kernel: int = 3) -> nn.Sequential:
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU())


class ParserNetwork(nn.Module):
    """Channels of `parser.network_input` [B, `inputs`, S, S] to logits [B, `labels`, S, S]; S is a multiple of 16."""

    def __init__(self, inputs: int, labels: int) -> None:
        super().__init__()
        self.stem = _block(inputs * FOLD**2, WIDTHS[0])
        self.down = nn.ModuleList(nn.Sequential(_block(a, b, 2), _block(b, b)) for a, b in pairwise(WIDTHS))
        self.middle = _block(WIDTHS[-1], WIDTHS[-1])
        self.narrow = nn.ModuleList(_block(b, a, kernel=1) for a, b in pairwise(WIDTHS))
        self.up = nn.ModuleList(_block(a, a) for a in WIDTHS[:-1])
        self.head = nn.Conv2d(WIDTHS[0], labels * FOLD**2, 1)
        self.direct = nn.Conv2d(inputs, labels, 1)  # what a pixel says by itself: the mesh's part is most of the answer

    def forward(self, value: Tensor) -> Tensor:
        """See the class."""
        direct = self.direct(value)
        value = self.stem(functional.pixel_unshuffle(value, FOLD))
        kept = []
        for down in self.down:
            kept.append(value)
            value = down(value)
        value = self.middle(value)
        for narrow, up, skip in reversed(list(zip(self.narrow, self.up, kept, strict=True))):
            value = up(functional.interpolate(narrow(value), scale_factor=2.0, mode="nearest") + skip)
        return functional.pixel_shuffle(self.head(value), FOLD) + direct


@lru_cache(maxsize=1)
def load_parser(inputs: int, labels: int) -> ParserNetwork:
    """Load the package's trained network.

    Raises:
        FileAccessError, FileFormatError: The asset is missing or damaged.
    """
    tensors, metadata = read_tensors(ASSET)
    network = ParserNetwork(inputs, labels)
    try:
        if metadata.get("format") != FORMAT or metadata.get("version") != VERSION:
            raise RuntimeError("another version")
        values = {name: torch.from_numpy(array).float() for name, array in tensors.items()}
        missing = network.load_state_dict(values, strict=False).missing_keys
        if not all(name.endswith("num_batches_tracked") for name in missing):
            raise RuntimeError("another network")
    except RuntimeError as error:
        raise FileFormatError(f"{ASSET} does not hold this version's photo parser; install the project again.") from error
    return network.eval().requires_grad_(requires_grad=False)
