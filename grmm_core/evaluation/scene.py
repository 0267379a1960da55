"""A trained model that draws captured views, with parts switched off on request. Used by `protocols` and `disentanglement`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..controls.frame import ResolvedControls
from ..errors import ConfigError
from ..geometry.camera import Camera
from ..model.grmm import GRMM, Rendering
from ..model.inputs import ModelInputs, Person, expression_code
from ..model.renewed import carried_over
from ..model.torch_loader import with_deltas
from ..model.weights import load_weights
from ..model.weights_file import WeightsInfo

if TYPE_CHECKING:
    from ..avatar import Avatar
    from ..data.dataset import CaptureDataset
    from ..data.types import Shot
    from ..head import HeadModel

FULL, NO_EXPRESSION_CODE, MEAN_CODES = "full", "z_exp off", "z_id mean, z_exp off"
VARIANTS = (FULL, NO_EXPRESSION_CODE, MEAN_CODES)
"""What of the residual codes is used. These switch codes of one model off; the paper's ablation trains another model."""


@dataclass(frozen=True, kw_only=True)
class DrawnPerson(Person):
    """Whom a model can draw: a person with what draws them.

    Attributes:
        name: For tables.
        model: The scene's model, or a copy with changed decoders.
        photo_code: z_exp as a whole in the photo that the person was fitted to, [Y], or None.
        avatar: What the person came from, or None.
    """

    name: str
    model: GRMM
    photo_code: np.ndarray | None = None
    avatar: Avatar | None = None


class Scene:
    """A trained model with its people.

    Args:
        path: Weights file.
        device: Torch device.
        backend: Rasteriser backend.
        head: Head model; the open head when None.
        avatar: One of the trained people with changes of their own (`training.personal`), to be judged alone.

    Raises:
        FileAccessError, FileFormatError: As `load_weights`.
        ConfigError: The avatar was made with other weights, or is nobody whom they were trained on.
    """

    def __init__(
        self, path: str | os.PathLike[str], device: str = "cpu", backend: str = "auto", head: HeadModel | None = None,
        avatar: Avatar | None = None,
    ) -> None:  # fmt: skip
        self.path = Path(path)
        model, info = load_weights(path, head)
        self.model: GRMM = model.requires_grad_(False).to(device)
        self.info: WeightsInfo = info
        self.backend = backend
        self.head: HeadModel = model.head_model
        self.mean_code: np.ndarray = info.z_id.mean(0) if len(info.z_id) else info.default_z_id
        self.avatar = None if avatar is None else replace(self.from_avatar(avatar), name=self._trained_name(avatar))

    @property
    def residuals(self) -> bool:
        """Whether the model has residual codes; without, it is the ablation of eq. 21."""
        return self.model.config.residuals

    @property
    def variants(self) -> tuple[str, ...]:
        """Forms in which the model can be judged."""
        return VARIANTS if self.residuals else (FULL,)

    def tensor(self, array: np.ndarray) -> Tensor:
        """Return an array as a float32 tensor on the model's device."""
        return torch.as_tensor(np.array(array, np.float32), device=self.model.device)

    def person(self, dataset: CaptureDataset, name: str) -> DrawnPerson | None:
        """The trained person of a capture's name; None where the model was not trained on them, or another one is judged."""
        if self.avatar is not None:
            return self.avatar if self.avatar.name in (name, f"{dataset.folder.name}/{name}") else None
        for known in (name, f"{dataset.folder.name}/{name}"):
            if known in self.info.people:
                row = self.info.people.index(known)
                return self.made(known, self.info.z_id[row], self.info.shapes[row])
        return None

    def knows(self, name: str) -> bool:
        """Whether anybody of this name was trained on, in whatever folder the data was then: such a person is not held out."""
        return any(known == name or known.endswith(f"/{name}") for known in self.info.people)

    def made(self, name: str, z_id: np.ndarray, shape: np.ndarray) -> DrawnPerson:
        """A person of given code and shape."""
        return DrawnPerson(z_id, shape, name=name, model=self.model)

    def from_avatar(self, avatar: Avatar) -> DrawnPerson:
        """The person in an avatar, with its changes of the decoders; of the first photo also the code of its expression."""
        deltas = carried_over(avatar.deltas, avatar.weights.sha256, self.info, self.model.layout, self.head)
        model = with_deltas(self.model, deltas, avatar.name)
        photo = None
        if self.residuals and "z_exp" in avatar.tracking and "aligned" in avatar.tracking:
            own, aligned = (avatar.tracking[name][0] for name in ("z_exp", "aligned"))
            photo = expression_code(model.input_space().codes, aligned, avatar.z_exp + own, None)
        return DrawnPerson(
            avatar.z_id, avatar.shape[: self.head.shape_count], avatar.z_exp, avatar.expression,
            name=avatar.name, model=model, photo_code=photo, avatar=avatar,
        )  # fmt: skip

    def _trained_name(self, avatar: Avatar) -> str:
        """Name of the training person whose code an avatar has."""
        if not self.info.draws(avatar.weights.sha256):
            raise ConfigError(f"The avatar {avatar.name!r} was made with other weights than {self.path}; use its own.")
        same = [name for name, code in zip(self.info.people, self.info.z_id, strict=True) if np.array_equal(code, avatar.z_id)]
        if not same:
            raise ConfigError(
                f"The avatar {avatar.name!r} is nobody whom the weights were trained on; judge it by photos, with "
                "--protocol monocular."
            )
        return same[0]

    def inputs(self, person: DrawnPerson, shot: Shot) -> ModelInputs[np.ndarray]:
        """What draws a person with a shot's expression and pose."""
        performed = ResolvedControls(shot.expression, shot.pose, shot.aligned)
        return person.model.input_space().frame(person, performed)

    def draw(
        self, person: DrawnPerson, shot: Shot, camera: Camera, variant: str = FULL, background: float = 0.0, photo: bool = False
    ) -> Rendering:
        """Draw a person with a shot's expression and pose.

        Args:
            person: Whom.
            shot: Expression and pose.
            camera: In head space.
            variant: One of `variants`.
            background: Grey behind the head.
            photo: The shot is the photo that the person was fitted to: use the code found there.

        Raises:
            ConfigError: The model has no residual codes to switch off.
        """
        if variant not in self.variants:
            raise ConfigError(f"The weights {self.info.name!r} cannot be drawn with {variant}; they have no residual codes.")
        inputs = self.inputs(person, shot)
        if photo and person.photo_code is not None:
            inputs = replace(inputs, z_exp=person.photo_code)
        if variant != FULL:
            inputs = replace(inputs, z_exp=np.zeros_like(inputs.z_exp))
        if variant == MEAN_CODES:
            inputs = replace(inputs, z_id=self.mean_code)
        with torch.no_grad():
            return person.model.render(camera, person.model.tensors(inputs), (background,) * 3, backend=self.backend)


def check_heads(scene: Scene, heads: Mapping[str, str]) -> None:
    """Refuse captures of another head model.

    Args:
        scene: Model.
        heads: Folder to the name of its head model.

    Raises:
        ConfigError: They differ.
    """
    for folder, name in heads.items():
        if name != scene.head.name:
            raise ConfigError(f"{folder} was made with the head model {name!r}, the weights with {scene.head.name!r}.")
