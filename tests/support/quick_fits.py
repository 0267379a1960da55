"""Fits that take seconds: a preset of few steps, and a look at which files a fit opens. The model is tiny and random."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import ImageFile

from grmm_core.fitting.presets import CodeSettings, DecoderSettings, Preset

QUICK = Preset("fast", CodeSettings(48, 48, 1, 1, 0, 2), DecoderSettings(((64, 4),), False))
"""What stands in for "fast" where the fixture `quick_preset` is used."""
QUICK_PIXELS = CodeSettings(48, 48, 1, 1, 0, 2)
QUICK_SIDE = 96
"""Likewise of `fitting.pixel_stage`: of the avatar that is compared, and the pictures' side, in pixels."""
PREPARE = """
import quick_fits
from grmm_core.fitting import pixel_stage, presets
presets.PRESETS["fast"] = quick_fits.QUICK
pixel_stage.QUICK, pixel_stage.SIDE = quick_fits.QUICK_PIXELS, quick_fits.QUICK_SIDE
"""
"""The same in processes of a cluster."""


@contextlib.contextmanager
def watching(*paths: Path) -> Iterator[tuple[dict[str, int], list[tuple[int, int]]]]:
    """How often each of some files is opened, and the sizes of all pictures that are decoded, while this lasts."""
    opened, decoded = {path.name: 0 for path in paths}, []
    known = {str(path) for path in paths}
    open_file, load = os.open, ImageFile.ImageFile.load

    def count(file: object) -> None:
        if str(file) in known:
            opened[Path(file).name] += 1

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "open", lambda file, *a, **k: (count(file), open_file(file, *a, **k))[1])
        # what is decoded already has no tiles left
        patch.setattr(
            ImageFile.ImageFile, "load", lambda self: (decoded.append(self.size) if self.tile else None, load(self))[1]
        )
        yield opened, decoded
