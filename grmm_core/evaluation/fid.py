"""FID (Heusel et al. 2017), the Fréchet distance of two sets of pictures, with an Inception network that the user has.

The file is a TorchScript module that takes pictures [B, 3, H, W] uint8 with `return_features=True` and gives features [B, F],
the form in which the original network is passed around (``inception-2015-12-05.pt``); it resizes by itself. None comes with
this project. Needs numpy; torch to run the network. Used by the command line and `report`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileFormatError
from ..files.access import read_start
from ..pictures.images import quantize

if TYPE_CHECKING:
    import torch
    from torch import Tensor

FID = "FID"
_SMALLEST = 64  # pixels: side of the picture that a network is tried on


class InceptionFeatures:
    """Features of pictures by a user's network.

    Args:
        path: TorchScript file; it holds code, as every module of that form does: take it from where you trust it.
        device: Where it runs.

    Raises:
        FileAccessError: The file cannot be read.
        FileFormatError: It is no such network.
    """

    def __init__(self, path: str | Path, device: torch.device | str = "cpu") -> None:
        import torch

        read_start(path)
        self.device = torch.device(device)
        try:
            self._network = torch.jit.load(str(path), map_location=self.device).eval()
            self(torch.zeros(_SMALLEST, _SMALLEST, 3))
        except (RuntimeError, ValueError, TypeError, AttributeError) as error:
            raise FileFormatError(
                f"{path} is not an Inception network for FID; give the TorchScript file inception-2015-12-05.pt."
            ) from error

    def __call__(self, picture: Tensor) -> np.ndarray:
        """Features [F], float64, of a picture [H, W, 3], display sRGB 0..1."""
        import torch

        pixels = torch.from_numpy(quantize(picture.detach().cpu().numpy())).to(self.device)
        with torch.no_grad():
            features: Tensor = self._network(pixels.permute(2, 0, 1)[None], return_features=True)
        if features.ndim != 2:
            raise ValueError("one row of features a picture")
        return features[0].double().cpu().numpy()


def frechet_distance(a: np.ndarray, b: np.ndarray) -> float:
    """|mean_a - mean_b|^2 + tr(C_a + C_b - 2 (C_a C_b)^(1/2)) of features [N, F] and [M, F]; nan for a single one.

    With C = X^T X the last trace is the sum of the singular values of X_a X_b^T, which is exact for fewer pictures than
    features, where a square root of the product of covariances is not.
    """
    if min(len(a), len(b)) < 2:
        return float("nan")
    means = a.mean(0), b.mean(0)
    spread_a, spread_b = ((x - mean) / np.sqrt(len(x) - 1) for x, mean in zip((a, b), means, strict=True))
    shared = np.linalg.svd(spread_a @ spread_b.T, compute_uv=False).sum()
    return float(np.square(means[0] - means[1]).sum() + np.square(spread_a).sum() + np.square(spread_b).sum() - 2.0 * shared)
