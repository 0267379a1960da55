"""FID against its textbook formula, with a network that a test makes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.data.dataset import CaptureDataset
from grmm_core.errors import FileAccessError, FileFormatError
from grmm_core.evaluation import report
from grmm_core.evaluation.fid import FID, InceptionFeatures, frechet_distance
from grmm_core.evaluation.protocols import Evaluation, Settings


class ColorFeatures(torch.nn.Module):
    """Stands for Inception: the mean colors of a picture's quarters."""

    def forward(self, pictures: torch.Tensor, return_features: bool = False) -> torch.Tensor:
        assert pictures.dtype == torch.uint8
        assert return_features
        return torch.nn.functional.adaptive_avg_pool2d(pictures.float() / 255.0, 2).flatten(1)


def test_fid_is_measured_with_a_users_network(scene, folder, tmp_path):
    path = tmp_path / "network.pt"
    torch.jit.script(ColorFeatures()).save(str(path))
    settings = Settings(ablations=False, regions=False, features=InceptionFeatures(path))
    runs = Evaluation(scene, [CaptureDataset(folder)], settings)
    result = runs.run("reconstruction")
    truth, drawn = (np.array(side) for side in zip(*(row.features for row in result.rows), strict=True))
    figure = report.summary(result)["refined"][FID]
    spreads = [np.cov(side, rowvar=False) for side in (truth, drawn)]
    roots = np.sqrt(np.linalg.eigvals(spreads[0] @ spreads[1]).astype(complex)).real.sum()
    expected = np.square(truth.mean(0) - drawn.mean(0)).sum() + np.trace(spreads[0]) + np.trace(spreads[1]) - 2.0 * roots
    assert figure == pytest.approx(expected, abs=1e-6)
    assert figure > 0.0
    assert FID in report.table({"reconstruction": report.summary(result)})
    (tmp_path / "other.pt").write_bytes(b"PK nothing")
    with pytest.raises(FileFormatError, match="inception-2015"):
        InceptionFeatures(tmp_path / "other.pt")
    with pytest.raises(FileAccessError):
        InceptionFeatures(tmp_path / "missing.pt")


def test_a_set_is_no_distance_from_itself():
    features = np.random.default_rng(0).normal(size=(6, 40))
    assert frechet_distance(features, features[::-1]) == pytest.approx(0.0, abs=1e-9)
    assert frechet_distance(features, features + 1.0) == pytest.approx(40.0)
    assert np.isnan(frechet_distance(features[:1], features))
