"""An avatar of a session painted onto its head's UV map, for wherever only the mesh is drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..controls.frame import Controls
from ..geometry.camera import Camera
from ..head import HeadModel
from ..model.painting import View, paint
from .api import Session
from .values import Instance, RenderOptions

_OPTIONS = RenderOptions(refine=False)  # what it adds is finer than the painting's texels


def painted(session: Session, avatar_id: int, head: HeadModel) -> np.ndarray:
    """Return the painting of an open avatar, as `Avatar.painting`; 21 pictures of 512 pixels.

    Raises:
        SessionError: There is no such avatar.
        GrmmError: The model cannot draw it.
    """

    def view(controls: Mapping[str, float], camera: Camera) -> View:
        posed = Controls().set_named(controls)
        buffers = session.render([Instance(avatar_id, posed)], camera, _OPTIONS)
        return View(session.deform(avatar_id, posed).vertices, buffers["rgb"], buffers["alpha"][..., 0])

    return paint(head, view)
