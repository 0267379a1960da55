"""People with the strands that their capture recorded, drawn as a session draws them, for views that show hair.

Weights of bare heads are judged on bare heads (`protocols`); this says how the whole person looks. Strands are the truth's own,
so that the figures are those of drawing them; their colors are found in views that the model may know.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from ..avatar import EXTENSION, Avatar, save_avatar
from ..controls.frame import Controls, resolve, weights_of
from ..data.dataset import CaptureDataset
from ..data.types import Shot
from ..fitting.hair_grain import directions
from ..geometry.camera import Camera
from ..head import arkit_gain
from ..light.lamps import Lighting
from ..light.shading import Response
from ..model.people import made_avatar
from ..session import FINAL_STRANDS, HairUse, create_session
from ..session.values import Instance, RenderOptions
from ..training.captured_hair import SeenIn, captured_hair
from .scene import DrawnPerson, Scene

_WINDOW, _CLEAR = 9, 0.5  # px and coherence, of `turned_degrees`
_BINOMIAL = (0.0625, 0.25, 0.375, 0.25, 0.0625)
_COVERED = 0.1  # share of a pixel without hair, below which it counts as covered
_LEAST = 200  # pixels of hair with a direction, below which a view says nothing about it


class Haired:
    """Draws people of one scene; to be closed.

    Args:
        scene: Model, on the CPU.
        datasets: Captures whose people are drawn.
        packed: With the strands that fit into a file instead of all that are recorded.
        strands: Of `RenderOptions`: 1 draws as views do.
    """

    def __init__(
        self, scene: Scene, datasets: Sequence[CaptureDataset], *, packed: bool = False, strands: float = FINAL_STRANDS
    ) -> None:
        self._scene, self._datasets, self._packed, self._strands = scene, datasets, packed, strands
        self._session = create_session("local", weights=scene.path, device="cpu")
        self._open: dict[int, tuple[DrawnPerson, int, HairUse]] = {}

    def close(self) -> None:
        """End the session."""
        self._session.close()

    def draw(
        self, person: DrawnPerson, shot: Shot, camera: Camera, seen: SeenIn, lighting: Lighting | None = None
    ) -> np.ndarray:  # fmt: skip
        """Draw a person over black, display sRGB [H, W, 3].

        Args:
            person: Whom.
            shot: Expression and pose.
            camera: In head space.
            seen: The views from which the hair's colors may be taken.
            lighting: Another light than the studio's, in the head's axes; no skin scatters it.
        """
        if id(person) not in self._open:
            self._open[id(person)] = (person, *self._opened(person, shot.subject, seen))
        gain = arkit_gain(self._scene.head, person.shape if person.avatar is None else person.avatar.shape)
        controls = Controls(aligned=weights_of(shot.aligned, gain))
        plain = resolve(controls, self._scene.head, gain)
        expression = np.zeros_like(controls.expression)
        more = (shot.expression - plain.expression)[: expression.size]
        expression[: more.size] = more
        controls = replace(controls, expression=expression, pose=(shot.pose - plain.pose).astype(np.float32))
        _, avatar, hair = self._open[id(person)]
        instance = Instance(avatar, controls, hair=hair, response=Response(scattering=0.0) if lighting else None)
        options = RenderOptions(background=(0.0, 0.0, 0.0), strands=self._strands, lighting=lighting)
        return self._session.render([instance], camera, options)["rgb"]

    def _opened(self, person: DrawnPerson, subject: str, seen: SeenIn) -> tuple[int, HairUse]:
        avatar, use = person.avatar or self._made(person), HairUse()
        if avatar.hair is None:
            hair = captured_hair(self._datasets, subject, self._scene.head, seen, even=True)
            if hair is not None and hair.groom is not None and not self._packed:  # all that are recorded: a file has fewer
                use = HairUse(self._session.put_groom(subject, "recorded", hair.groom), hair.settings, parts=hair.parts)
                hair = replace(hair, groom=None)
            avatar = replace(avatar, hair=hair)
        with tempfile.TemporaryDirectory(prefix="grmm-evaluate-") as folder:
            path = Path(folder) / f"person{EXTENSION}"
            save_avatar(avatar, path)
            return self._session.open(path).id, use

    def _made(self, person: DrawnPerson) -> Avatar:
        return made_avatar(person.name, self._scene.info, self._scene.model.z_exp_size, person.z_id, person.shape)


def turned_degrees(image: np.ndarray, truth: np.ndarray, hair: np.ndarray) -> float:
    """Mean angle between the directions of strands where the truth has a clear one, degrees; NaN where it hardly has any.

    Pictures are blurred a little, borders of hair left out, and directions averaged over a window so large that the grain of
    a truth of few samples has no clear one: of white noise, 3 % of the pixels do (49 % in 5 unblurred pixels at 0.25).

    Args:
        image: [H, W, 3].
        truth: [H, W, 3].
        hair: Cover of hair in the truth, [H, W].
    """
    edge = 2 * (_WINDOW // 2) + 5
    outside = functional.max_pool2d(torch.from_numpy(1.0 - np.asarray(hair, np.float32))[None, None], edge, 1, edge // 2)
    inside = (outside[0, 0].numpy() < _COVERED).astype(float)
    true = np.stack(directions(_soft(truth), inside, _WINDOW, _CLEAR))
    sure = np.hypot(*true) > 0
    if sure.sum() < _LEAST:
        return float("nan")
    own = np.stack(directions(_soft(image), inside, _WINDOW, 0.0))
    doubled = np.arctan2(own[1], own[0])[sure] - np.arctan2(true[1], true[0])[sure]
    return float(np.degrees(np.abs((doubled + np.pi) % (2 * np.pi) - np.pi)).mean() / 2)


def _soft(image: np.ndarray) -> np.ndarray:
    """A picture [H, W, 3] blurred by one pixel of standard deviation."""
    height, width = image.shape[:2]
    padded = np.pad(image, ((2, 2), (2, 2), (0, 0)), mode="edge")
    down = np.asarray(sum(weight * padded[k : k + height] for k, weight in enumerate(_BINOMIAL)))
    return np.asarray(sum(weight * down[:, k : k + width] for k, weight in enumerate(_BINOMIAL)))
