"""The inversion's state in a work folder, so that an interrupted fit goes on: tensor files, never pickle.

A file belongs to one job, told by a key over tracking, weights and settings; a file of another job, or a damaged one, is
ignored and the stage is done anew. Called by `invert`.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..errors import FileAccessError, FileFormatError
from ..files.tensorfile import read_tensors, write_tensors
from ..model.weights_file import WeightsInfo
from .code_stage import Codes
from .decoder_stage import Tuner
from .folder import CODES_FILE, DECODERS_FILE
from .presets import Preset
from .types import PhotoTrack

FORMAT, VERSION = "grmm-fit", "1"

logger = logging.getLogger(__name__)


def codes_key(tracks: Sequence[PhotoTrack], info: WeightsInfo, preset: Preset) -> str:
    """Hash of everything that stage 1's result depends on."""
    digest = hashlib.sha256(f"{VERSION} {info.name} {info.sha256} {info.head_sha256} {preset.codes!r}".encode())
    for track in tracks:
        camera = track.camera
        digest.update(repr((track.source, camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)).encode())
        for array in (
            track.image, track.mask, track.valid, camera.world_to_camera, track.shape, track.expression, track.pose,
        ):  # fmt: skip
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def decoders_key(codes: str, preset: Preset, locality: float) -> str:
    """Hash of everything that stage 2's result depends on."""
    return hashlib.sha256(f"{codes} {preset.decoders!r} {locality!r}".encode()).hexdigest()


def save_codes(folder: Path, key: str, codes: Codes) -> None:
    """Write stage 1's result, to be found by `load_codes` with the same key. Raises `FileAccessError`."""
    _write(folder / CODES_FILE, key, {
        "z_id": codes.z_id, "z_exp": codes.z_exp, "photo_z_exp": codes.photo_z_exp, "maps": codes.maps,
    })  # fmt: skip


def load_codes(folder: Path, key: str, like: Tensor) -> Codes | None:
    """Read stage 1's result onto the device of `like`; None where this job has none."""
    tensors = _read(folder / CODES_FILE, key, like)
    if tensors is None:
        return None
    try:
        z_id, z_exp, photo_z_exp, maps = (tensors[name] for name in ("z_id", "z_exp", "photo_z_exp", "maps"))
        return Codes(z_id, z_exp, photo_z_exp, maps)
    except KeyError:
        logger.warning("%s is incomplete; the codes are searched anew", folder / CODES_FILE)
        return None


def save_tuner(folder: Path, key: str, tuner: Tuner) -> None:
    """Write stage 2's maps, networks and optimiser, for `resume_tuner` with the same key. Raises `FileAccessError`."""
    _write(folder / DECODERS_FILE, key, tuner.state())


def resume_tuner(folder: Path, key: str, tuner: Tuner) -> bool:
    """Bring a tuner to the saved state; False where this job has none."""
    tensors = _read(folder / DECODERS_FILE, key, tuner.tint)
    if tensors is None:
        return False
    try:
        tuner.restore(tensors)
    except (KeyError, RuntimeError):
        logger.warning("%s does not fit the model; the decoders are tuned anew", folder / DECODERS_FILE)
        return False
    return True


def _write(path: Path, key: str, tensors: dict[str, Tensor]) -> None:
    arrays = {name: value.detach().cpu().numpy() for name, value in tensors.items()}
    write_tensors(path, arrays, {"format": FORMAT, "version": VERSION, "job": key})


def _read(path: Path, key: str, like: Tensor) -> dict[str, Tensor] | None:
    if not path.exists():
        return None
    try:
        arrays, metadata = read_tensors(path)
    except (FileFormatError, FileAccessError) as error:
        logger.warning("the state of the interrupted fit cannot be used: %s", error)
        return None
    if metadata.get("format") != FORMAT or metadata.get("version") != VERSION or metadata.get("job") != key:
        return None
    finite = all(np.isfinite(array).all() for array in arrays.values())
    return {name: torch.tensor(array, device=like.device) for name, array in arrays.items()} if finite else None
