"""What an avatar is: codes, shape, references to head and weights, provenance.

`file` reads and writes it, `session` turns it into pictures. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from .. import __version__
from ..errors import ShapeError
from ..geometry.camera import Camera
from ..hair.groom import Groom
from ..hair.settings import HairSettings

MADE_BY = f"grmm {__version__}"
SHAPE_SIZE = 300
JOINT_COUNT = 5
MAX_CODE_SIZE = 4096  # far above any configuration; refuses absurd files
MAX_THUMBNAIL_BYTES = 4 << 20
MAX_PAINTING = 2048  # pixels
MAX_NAME_LENGTH = 200


@dataclass(frozen=True)
class AssetReference:
    """A head model or trained weights that an avatar needs.

    Attributes:
        name: Asset name, such as "open_head" or "default".
        sha256: Hash of the asset, 64 hexadecimal digits, or "" when it was not known.
    """

    name: str
    sha256: str = ""


@dataclass(frozen=True)
class PhotoRecord:
    """A photo that an avatar was made from: its file name and the hash of its bytes, never the photo itself."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """Where an avatar comes from.

    Attributes:
        made_by: Program and version.
        from_photos: The avatar shows a real person.
        photos: The photos used.
        date: ISO 8601 date, or "".
        licence: What the maker says about use and consent.
    """

    made_by: str = ""
    from_photos: bool = False
    photos: tuple[PhotoRecord, ...] = ()
    date: str = ""
    licence: str = ""


@dataclass(frozen=True)
class Hair:
    """The strands of a person.

    Attributes:
        groom: On the head model, of all parts; None for a person without any, whatever the Gaussians were trained with.
        settings: Length, color and so on.
        parts: Settings of brows, beard and lashes where they are not what `HairSettings.for_part` gives; by `roots.GROUPS`.
        scalp: The strands stand for the scalp's hair, so that without any there the person is bald; else that of the
            Gaussians stays.
    """

    groom: Groom | None
    settings: HairSettings = field(default_factory=HairSettings)
    parts: Mapping[str, HairSettings] = field(default_factory=dict)
    scalp: bool = True


@dataclass(frozen=True)
class Avatar:
    """One person of the model.

    Arrays are float32, finite and read-only after construction.

    Attributes:
        name: Display name.
        head: Head model that `shape` and `expression` refer to.
        weights: Trained weights that the codes refer to.
        z_id: Residual identity code, [Z].
        z_exp: Offset to the residual expression code in every expression (what is personal about the neutral face), [Y].
        shape: Shape coefficients alpha_id of the head model, [300].
        expression: Offset to the expression coefficients in every expression, [<=100].
        pose: XYZ Euler angles in radians of root, neck, jaw and eyes at rest, [5, 3].
        camera: Camera of the (first) photo in head space, or None.
        tracking: Other results of tracking, by name, any shape; per-photo arrays have the photo as first axis.
        deltas: Stage-2 changes of the weights (eq. 20), by parameter name, same shape as the parameter.
        provenance: Where it comes from.
        thumbnail: PNG bytes, or empty.
        painting: The person on the head's UV map, display sRGB, uint8, [P, P, 3], the row of v = 0 first; [0, 0, 3] for none.
        hair: Strands; None where hair is only in the Gaussians.
    """

    name: str
    head: AssetReference
    weights: AssetReference
    z_id: np.ndarray
    z_exp: np.ndarray
    shape: np.ndarray = field(default_factory=lambda: np.zeros(SHAPE_SIZE, np.float32))
    expression: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    pose: np.ndarray = field(default_factory=lambda: np.zeros((JOINT_COUNT, 3), np.float32))
    camera: Camera | None = None
    tracking: Mapping[str, np.ndarray] = field(default_factory=dict)
    deltas: Mapping[str, np.ndarray] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)
    thumbnail: bytes = b""
    painting: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))
    hair: Hair | None = None

    def __post_init__(self) -> None:
        for name in ("z_id", "z_exp", "shape", "expression", "pose"):
            object.__setattr__(self, name, _frozen(name, getattr(self, name)))
        for name in ("tracking", "deltas"):
            arrays = {key: _frozen(f"{name}/{key}", value) for key, value in getattr(self, name).items()}
            object.__setattr__(self, name, MappingProxyType(arrays))
        for name, limit in (("z_id", MAX_CODE_SIZE), ("z_exp", MAX_CODE_SIZE), ("expression", MAX_CODE_SIZE)):
            shape = getattr(self, name).shape
            if len(shape) != 1 or shape[0] > limit:
                raise ShapeError(f"Avatar.{name} has shape {shape}; it must be one row of at most {limit} values.")
        if self.shape.shape != (SHAPE_SIZE,):
            raise ShapeError(f"Avatar.shape has shape {self.shape.shape}; it must be ({SHAPE_SIZE},).")
        if self.pose.shape != (JOINT_COUNT, 3):
            raise ShapeError(f"Avatar.pose has shape {self.pose.shape}; it must be ({JOINT_COUNT}, 3).")
        if len(self.thumbnail) > MAX_THUMBNAIL_BYTES:
            raise ShapeError(f"The thumbnail has {len(self.thumbnail)} bytes; it may have {MAX_THUMBNAIL_BYTES}.")

        painting = self.painting
        if painting.dtype != np.uint8 or painting.shape != (len(painting), len(painting), 3) or len(painting) > MAX_PAINTING:
            raise ShapeError(
                f"Avatar.painting is {painting.dtype} of shape {painting.shape}; it must be uint8, [P, P, 3] with P at most "
                f"{MAX_PAINTING}."
            )

    def with_pictures(self, thumbnail: bytes, painting: np.ndarray) -> Avatar:
        """Return a copy that carries other pictures of itself."""
        return replace(self, thumbnail=thumbnail, painting=painting)


def _frozen(name: str, value: np.ndarray) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise ShapeError(f"Avatar.{name} has data type {array.dtype}; it must hold numbers.")
    if array.dtype != np.float32 or array.flags.writeable:
        array = np.array(array, np.float32)
        array.flags.writeable = False
    if not np.isfinite(array).all():
        raise ShapeError(f"Avatar.{name} holds a value that is not a finite number; make or fit the avatar again.")
    return array
