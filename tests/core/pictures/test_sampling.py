"""Values of pictures between their pixels."""

from __future__ import annotations

import numpy as np

from grmm_core.pictures.sampling import bilinear


def test_sampling_is_bilinear_at_pixel_centres():
    picture = np.arange(12.0).reshape(3, 4)
    np.testing.assert_allclose(bilinear(picture, np.array([[0.5, 0.5], [1.0, 0.5], [3.5, 2.5], [99.0, -5.0]])), [0, 0.5, 11, 3])
