"""Portraits: the camera that shows a whole head, and pictures of a person outside any session.

Thumbnails of files, sheets of training, fitting and evaluation come from here. Importing this module is light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ..controls.frame import Controls
from ..geometry.camera import Camera
from ..pictures.color import straight_rgba
from ..pictures.images import encode_png, quantize

if TYPE_CHECKING:
    from .grmm import GRMM, Picture
    from .inputs import AnyPerson

PORTRAIT_DISTANCE = 1.1
PORTRAIT_FOV = 23.0
"""Metres and degrees of a camera that shows the whole head with hair, as in the training pictures."""
THUMBNAIL_PIXELS = 192


def portrait_camera(pixels: int, yaw: float = 0.0, pitch: float = 0.0) -> Camera:
    """Camera of a square picture of a whole head; angles in degrees as `Camera.orbit`."""
    return Camera.orbit(pixels, pixels, yaw=yaw, pitch=pitch, distance=PORTRAIT_DISTANCE, fov=PORTRAIT_FOV)


def portrait(
    model: GRMM, person: AnyPerson, controls: Mapping[str, float], camera: Camera,
    background: Sequence[float] | None = None, backend: str = "auto",
) -> Picture:  # fmt: skip
    """Draw a person with named controls, without gradients.

    Args:
        model: With the person's own changes of the weights.
        person: Codes, shape and resting expression.
        controls: As `Controls.set_named` takes them; empty for the neutral face.
        camera: In head space.
        background: Display sRGB, [3]; black when None.
        backend: Of the rasteriser.
    """
    import torch

    inputs = model.input_space().inputs(person, Controls().set_named(controls))
    with torch.no_grad():
        return model.render(camera, model.tensors(inputs), background, backend=backend)


def thumbnail(model: GRMM, person: AnyPerson, pixels: int = THUMBNAIL_PIXELS) -> bytes:
    """PNG of a person's neutral face, straight color with alpha. Arguments as `portrait`."""
    picture = portrait(model, person, {}, portrait_camera(pixels))
    rgb, alpha = (part.float().cpu().numpy() for part in (picture.image, picture.alpha[..., None]))
    return encode_png(quantize(straight_rgba(rgb, alpha)))
