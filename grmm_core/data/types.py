"""What every data set is made of, whoever captured it: people, shots, views, pictures, and which of them are held out.

`dataset` keeps these in a folder, `foreign` and the readers make them of other projects' files. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.camera import Camera

TRAIN, HELD_OUT_PERSON, HELD_OUT_EXPRESSION, HELD_OUT_CAMERA = "train", "person", "expression", "camera"
SPLITS = (TRAIN, HELD_OUT_PERSON, HELD_OUT_EXPRESSION, HELD_OUT_CAMERA)


@dataclass(frozen=True)
class View:
    """One picture of a shot.

    Attributes:
        name: Camera name.
        camera: Camera in head space.
        image, depth: File names in the shot's folder; depth may be empty.
        split: One of `SPLITS`.
        layers: File names of further layers, by the names of `layers`.
        bare: The same view of the same person without any hair, where the source has one; of the same files where the source
            shows the person in no other way.
    """

    name: str
    camera: Camera
    image: str
    depth: str
    split: str
    layers: dict[str, str] = field(default_factory=dict)
    bare: View | None = None

    @property
    def only_bare(self) -> bool:
        """Whether the person's hair is left out of the picture itself."""
        return self.bare is not None and self.bare.image == self.image


@dataclass(frozen=True)
class Shot:
    """One expression of one person.

    Attributes:
        subject: Person's name.
        number: Number of the shot.
        kind: "neutral", "single", "mix" or what the source calls it.
        aligned: Weights of the 60 aligned expressions, [60].
        expression: Head-model coefficients, [E].
        pose: XYZ Euler angles of the five joints including those of the expression, radians, [5, 3].
        views: Pictures.
        folder: Where the pictures are.
        displacement: What was added to the posed vertices of the mesh model, in head space, metres, [V, 3]; None: nothing.
        light: What the source says about its light.
    """

    subject: str
    number: int
    kind: str
    aligned: np.ndarray
    expression: np.ndarray
    pose: np.ndarray
    views: tuple[View, ...]
    folder: Path
    displacement: np.ndarray | None = None
    light: dict[str, Any] = field(default_factory=dict)

    def shown(self, bare: bool) -> list[View]:
        """The views with the person's hair; or those without it, and of sources that have none of these what there is."""
        return [view.bare or view for view in self.views] if bare else [view for view in self.views if not view.only_bare]


@dataclass(frozen=True)
class Picture:
    """A decoded view.

    Attributes:
        rgb: Straight display sRGB 0..1, float32, [H, W, 3].
        mask: Coverage 0..1, float32, [H, W].
        depth: Metres along the optical axis, 0 where nothing is, float32, [H, W]; None where the source has none.
        layers: Further layers to be written; those of a stored view are read by `CaptureDataset.layer`.
        bare: The same without hair, to be written.
    """

    rgb: np.ndarray
    mask: np.ndarray
    depth: np.ndarray | None
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    bare: Picture | None = None

    def over(self, background: float | np.ndarray) -> np.ndarray:
        """Color over a constant background 0..1, [H, W, 3]."""
        alpha = self.mask[..., None]
        return (self.rgb * alpha + np.asarray(background, np.float32) * (1 - alpha)).astype(np.float32)


@dataclass
class Manifest:
    """What `dataset.json` says.

    Attributes:
        head: Name of the head model.
        subjects: People's names, in order.
        settings: How it was made; the studio's own keys.
        held_out_people: Names.
    """

    head: str
    subjects: list[str]
    settings: dict[str, Any] = field(default_factory=dict)
    held_out_people: list[str] = field(default_factory=list)
