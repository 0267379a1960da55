"""From a frame's plain values to pass values: open the avatars, let the session draw, put the scene in front.

Shared by final renders and the viewport. Touches none of Blender's data, so that it may run on any thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...grmm_core.camera import Camera
from ...grmm_core.errors import CancelledError, GrmmError
from ...grmm_core.session import CancelCheck, Instance, RenderOptions
from .. import session_host
from . import passes, picture, snapshot
from .snapshot import AvatarShot, Occluders, Region

Progress = Callable[[float, str], None]

OPENED, DRAWN = 0.1, 0.8  # of the progress: when the session begins and has ended


@dataclass(frozen=True)
class DrawSettings:
    """How a picture is made.

    Attributes:
        refine: Run the refinement network.
        lod: Level of detail, see `RenderOptions`.
        samples: Samples per pixel and direction along the edges of meshes.
    """

    refine: bool = True
    lod: int = 0
    samples: int = 3


@dataclass(frozen=True)
class Frame:
    """Everything of one moment that a picture is made from.

    Attributes:
        avatars: Avatars to draw.
        camera: Camera of the full picture.
        occluders: Meshes that hide.
        clip: Nearest and farthest distance that the camera sees, metres.
    """

    avatars: list[AvatarShot]
    camera: Camera
    occluders: Occluders
    clip: tuple[float, float]


def frame_values(
    frame: Frame,
    settings: DrawSettings,
    items: list[passes.RenderPass],
    world: np.ndarray | None,
    region: Region,
    should_cancel: CancelCheck,
    progress: Progress = lambda fraction, text: None,
) -> dict[str, np.ndarray]:
    """Return the values of passes, each [H, W, C] of the region, top row first.

    Args:
        frame: What to draw.
        settings: How to draw it.
        items: Passes.
        world: Scene-linear colour of the background, [3], or None for a transparent film.
        region: Part of the picture that is returned; all of it is drawn.
        should_cancel: Asked now and then.
        progress: Told where this stands.

    Raises:
        CancelledError: `should_cancel` said so.
        GrmmError: An avatar or the session cannot be used.
    """
    if should_cancel():
        raise CancelledError("The render was cancelled.")
    progress(0.0, "opening avatars")
    instances = open_instances(frame.avatars)
    progress(OPENED, f"drawing {len(instances)} avatar{'s' if len(instances) != 1 else ''}")
    hidden = len(frame.occluders.triangles) + len(frame.occluders.holdouts) > 0  # perhaps: their depths are compared
    wanted = tuple(dict.fromkeys((*passes.session_passes(items), *(["depth"] if hidden else []))))
    options = RenderOptions(refine=settings.refine, passes=wanted, lod=settings.lod)
    buffers = session_host.get_session().render(instances, frame.camera, options, should_cancel)
    progress(DRAWN, "putting the scene in front")
    rows = slice(frame.camera.height - region.y - region.height, frame.camera.height - region.y)
    columns = slice(region.x, region.x + region.width)
    buffers = {name: buffer[rows, columns] for name, buffer in buffers.items()}
    camera = snapshot.crop_camera(frame.camera, region)
    visible = picture.Visibility()
    if hidden:
        depth, film = buffers["depth"][..., 0], world is not None
        visible = picture.visibility(frame.occluders, depth, camera, settings.samples, frame.clip, film)
    names = [shot.name for shot in frame.avatars]
    values = {item.name: picture.pass_values(item, buffers, visible, world, names) for item in items}
    progress(1.0, "done")
    return values


def open_instances(shots: list[AvatarShot]) -> list[Instance]:
    """Open avatars and splat clouds in the session and place them. Errors name the object."""
    instances = []
    for shot in shots:
        try:
            if shot.cloud is None:
                number = session_host.open_avatar(shot.source).id
            else:
                number = session_host.open_cloud(shot.cloud)
            instances.append(Instance(number, shot.controls.validate(), shot.model_to_world))
        except GrmmError as error:
            raise type(error)(f"{shot.name}: {error}") from error
    return instances
