"""From an avatar's source to what the rig is built from: head model, resting shape and expression, code sizes.

Works with numpy alone, so that a head can be added and animated where there is no runtime. Used by `build` and the relink
operator; imports neither bpy nor torch.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...grmm_core.avatar import AssetReference, Hair, load_avatar
from ...grmm_core.avatar.library import DEFAULT_NAME, library_file, library_path
from ...grmm_core.controls.table import EXPRESSION, SHAPE, Z_EXP, Z_ID
from ...grmm_core.errors import FileAccessError, FileFormatError
from ...grmm_core.hair import HairSettings
from ...grmm_core.head import HeadModel, load_flame, load_open_head
from ...grmm_core.model.parameters import code_sizes
from ...grmm_core.model.people import sampled_avatar
from ...grmm_core.model.weights_file import read_weights, resolve_weights
from ...grmm_core.session.sources import SAMPLE_PREFIX
from .. import session_host

DEFAULT_SOURCE = "default"
FLAME_PREFIX = "flame:"
"""Before the path of a user's FLAME file, in an avatar's source and in the name of its head model."""
OPEN_HEAD = "open_head"
_PAPER_SIZES = (512, 256)  # z_id, z_exp


@dataclass(frozen=True)
class Identity:
    """What a rig needs to know of an avatar.

    Attributes:
        name: Display name.
        head: Head model.
        shape: Its own shape coefficients, [<=S]; the rig's resting mesh.
        expression: Its own offset to the expression coefficients, [<=E].
        z_id_size, z_exp_size: Length of the residual codes.
        z_id: Its own identity code, [z_id_size], or None.
        weights: Hashes of the weights that its codes belong to.
        painting: The person on the head's UV map, `Avatar.painting`, or None for a plain face.
        reference: What the rig stores as its head model, for `load_head`; empty for the head's name.
        hair: Length, color and so on of the strands that the avatar has of its own, or None.
        offset: What the person's resting mesh has beyond the shape coefficients, metres, [V, 3], or None.
    """

    name: str
    head: HeadModel
    shape: np.ndarray
    expression: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    z_id_size: int = _PAPER_SIZES[0]
    z_exp_size: int = _PAPER_SIZES[1]
    z_id: np.ndarray | None = None
    weights: tuple[str, ...] = ()
    offset: np.ndarray | None = None
    painting: np.ndarray | None = None
    reference: str = ""
    hair: HairSettings | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Length of each array of controls on this head; 0 where it has none."""
        head = self.head
        return {SHAPE: head.shape_count, EXPRESSION: head.expression_count, Z_ID: self.z_id_size, Z_EXP: self.z_exp_size}

    @property
    def vertices(self) -> np.ndarray:
        """The resting mesh before skinning, head space, metres, [V, 3]."""
        shaped = self.head.shaped(self.shape, self.expression)
        return shaped if self.offset is None else shaped + self.offset

    @property
    def joints(self) -> np.ndarray:
        """Rest joints, head space, metres, [5, 3]; offsets move them as the regressor says, as FLAME trackers have it."""
        joints = self.head.joints(self.shape)
        return joints if self.offset is None else joints + np.asarray(self.head.J_regressor @ self.offset, np.float32)

    @property
    def resting_pose(self) -> np.ndarray:
        """Euler angles in radians that the avatar's own expression adds to the joints, [5, 3]."""
        return self.head.pose_of(self.expression)


def read_identity(source: str) -> Identity:
    """Return the identity of a source.

    Args:
        source: "default", "library:NAME", "sample:SEED", the absolute path of a `.grmm` file, or `FLAME_PREFIX` and the path
            of the user's FLAME file: its mean head, which no network draws.

    Raises:
        FileAccessError, FileFormatError: The file is missing, damaged, or of a head model that is not installed.
    """
    source = avatar_file(source)
    if source.startswith(SAMPLE_PREFIX):
        return _random_person(source)
    if source.startswith(FLAME_PREFIX):
        head = load_head(AssetReference(source))
        name = Path(source.removeprefix(FLAME_PREFIX)).stem
        return Identity(name, head, np.zeros(head.shape_count, np.float32), z_id_size=0, z_exp_size=0, reference=source)
    avatar = load_avatar(source)
    head = load_head(avatar.head)
    if avatar.shape[head.shape_count :].any() or avatar.expression.size > head.expression_count:
        raise FileFormatError(f"{source} does not fit the head model {head.name!r}; make the avatar anew.")
    painting = avatar.painting if avatar.painting.size else None
    sizes = avatar.z_id.size, avatar.z_exp.size
    hair = None if avatar.hair is None else avatar.hair.settings
    shape = avatar.shape[: head.shape_count]
    own = avatar.z_id, (avatar.weights.sha256,)
    return Identity(avatar.name, head, shape, avatar.expression, *sizes, *own, painting=painting, hair=hair)


def _random_person(source: str) -> Identity:
    """The person of a "sample:SEED": the shape needs no network; what they look like does (`repaint`)."""
    weights = read_weights(resolve_weights(session_host.settings().weights or None)).info
    head = load_head(AssetReference(weights.head_name))
    sizes = code_sizes(weights.config, head)
    person = sampled_avatar(weights, sizes[1], int(source.removeprefix(SAMPLE_PREFIX)), head)
    return Identity(
        person.name, head, person.shape[: head.shape_count], z_id_size=sizes[0], z_exp_size=sizes[1], z_id=person.z_id,
        weights=(weights.sha256, *weights.continued),
    )  # fmt: skip


def avatar_file(source: str) -> str:
    """Return the `.grmm` file of a source, and the source itself where it has none."""
    return str(library_path(DEFAULT_NAME) if source == DEFAULT_SOURCE else library_file(source) or source)


def own_hair(source: str) -> Hair | None:
    """Return the strands that an avatar has of its own, None where its hair is in its Gaussians. Raises as `read_identity`."""
    file = avatar_file(source)
    return None if file.startswith((SAMPLE_PREFIX, FLAME_PREFIX)) else load_avatar(file).hair


def load_head(reference: AssetReference) -> HeadModel:
    """Return an installed head model by name, or the user's FLAME file by `FLAME_PREFIX` and its path.

    Raises:
        FileFormatError: There is none of that name.
        FileAccessError: The FLAME file is gone.
    """
    if reference.name == OPEN_HEAD:
        return load_open_head()
    if reference.name.startswith(FLAME_PREFIX):
        path = Path(reference.name.removeprefix(FLAME_PREFIX))
        try:
            return _flame(path, path.stat().st_mtime_ns)
        except OSError as error:
            raise FileAccessError(f"The FLAME file {path} cannot be read; put it back or import the avatar again.") from error
    raise FileFormatError(f"The head model {reference.name!r} is not installed; use an avatar of the open head.")


@functools.lru_cache(maxsize=2)
def _flame(path: Path, stamp: int) -> HeadModel:
    """Read a FLAME file once for each time that it was written; asked for on every frame."""
    return load_flame(path)
