"""Drawing the people of a run: a view's person, expression and camera, differentiably. Used by `trainer` and `preview`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..model.grmm import GRMM, Rendering
from ..model.inputs import Person
from .losses import Target
from .views import View


@dataclass
class Cast:
    """The people of a run and the model that draws them.

    Attributes:
        model: In training.
        codes: z_id of each person, [P, Z].
        shapes: Shape coefficients of each person, [P, S].
        backend: Of the rasteriser.
    """

    model: GRMM
    codes: Tensor
    shapes: Tensor
    backend: str = "auto"

    def draw(self, view: View, background: np.ndarray | None, refined: bool) -> Rendering:
        """Render a view's person, expression and camera over a color [3], differentiably in the codes."""
        performed = (self.tensor(array) for array in (view.expression, view.pose, view.aligned))
        inputs = self.model.performed(self.codes[view.subject], self.shapes[view.subject], *performed)
        behind = None if background is None else self.tensor(background)
        limits = None if view.depths is None else self.tensor(view.depths)
        return self.model.render(view.camera, inputs, behind, refined, self.backend, limits)

    def target(self, view: View, background: Sequence[float] | np.ndarray) -> Target:
        """What the rendering over a color [3] should be."""
        mask = self.tensor(view.mask) / 255.0
        image = self.tensor(view.image) / 255.0 + (1.0 - mask)[..., None] * self.tensor(background)
        detail = None if view.detail is None else self.tensor(view.detail) / 255.0
        return Target(image, mask, None if view.depth is None else self.tensor(view.depth), self._vertices(view), detail)

    def _vertices(self, view: View) -> Tensor | None:
        """Where the posed mesh should be, [V, 3] metres, where the data knows."""
        if view.displacement is None:
            return None
        with torch.no_grad():
            model = self.model.vertices(self.shapes[view.subject], self.tensor(view.expression), self.tensor(view.pose))
        return model + self.tensor(view.displacement)

    def person(self, index: int) -> Person:
        """One of the people as the portraits take them."""
        return Person(*(table[index].detach().float().cpu().numpy() for table in (self.codes, self.shapes)))

    def tensor(self, array: Sequence[float] | np.ndarray) -> Tensor:
        """An array as a tensor where the model is, float32."""
        return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=self.model.device)
