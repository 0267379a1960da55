"""The open head and its landmarks, a face to fit, and quick fits of it, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from photo_parts import parts_of
from PIL import Image
from quick_fits import QUICK, QUICK_PIXELS, QUICK_SIDE

from grmm_core.fitting import photo_targets, pixel_stage, presets
from grmm_core.fitting.api import FitResult, fit
from grmm_core.fitting.point_rig import LandmarkRig
from grmm_core.fitting.request import FitRequest
from grmm_core.fitting.types import PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.head import HeadModel
from grmm_core.head.open_head import load_open_head
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM
from grmm_core.photo.parser import PhotoParts


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_open_head()


@pytest.fixture(scope="module")
def rig(head: HeadModel) -> LandmarkRig:
    return LandmarkRig(head)


@pytest.fixture(scope="module")
def bare() -> GRMM:
    """A small model without hair, with texels where eyes look, as the embedded weights have them."""
    torch.manual_seed(0)
    config = PRESETS["tiny"].replace(grid=256, decoder_grid=16, hairless=True, focus=True)
    return GRMM(load_open_head(), config).requires_grad_(False).eval()


@pytest.fixture(scope="module")
def only_skin() -> Iterator[None]:
    """Stands in for the photo parser, which knows people only: all of the person is skin."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(photo_targets, "parse", _only_skin)
        yield


def _only_skin(track: PhotoTrack, _: HeadModel) -> PhotoParts:
    return parts_of(1.0 - track.mask)


@pytest.fixture(scope="session")
def photo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A picture of the embedded avatar: a face that nobody owns, found by the same networks as a real one."""
    from grmm_core.session import create_session
    from grmm_core.session.api import Instance, RenderOptions

    with create_session("local") as session:
        avatar = session.open("default")
        camera = Camera.orbit(256, 256, distance=1.1, fov=18.0)
        options = RenderOptions(passes=("rgb",), background=(0.6, 0.65, 0.7))
        picture = session.render([Instance(avatar.id)], camera, options)["rgb"]
    path = tmp_path_factory.mktemp("photos") / "face.png"
    Image.fromarray((np.clip(picture, 0, 1) * 255).astype(np.uint8)).save(path)
    return path


@pytest.fixture
def make(weights: Path) -> Callable[..., FitResult]:
    """Ask for a fit by the tiny model and make it; options of the request, and of `fit`."""

    def make(photos, output, *, progress=None, on_faces=None, cancelled=None, **options) -> FitResult:
        values = {"preset": "fast", "weights": weights, "device": "cpu"} | options
        return fit(FitRequest(photos, output, **values), progress=progress, on_faces=on_faces, cancelled=cancelled)

    return make


@pytest.fixture(scope="module")
def quick_preset() -> Iterator[None]:
    """The preset "fast" is `quick_fits.QUICK`, and photos are tracked on pictures that are as small."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(presets.PRESETS, "fast", QUICK)
        patch.setattr(pixel_stage, "QUICK", QUICK_PIXELS)
        patch.setattr(pixel_stage, "SIDE", QUICK_SIDE)
        yield
