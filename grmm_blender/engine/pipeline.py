"""From a frame's plain values to pass values: open the avatars, let the session draw, put the scene in front.

Shared by final renders and the viewport. Touches none of Blender's data, so that it may run on any thread.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future, wait
from dataclasses import dataclass

import numpy as np

from ...grmm_core.controls.frame import Controls
from ...grmm_core.errors import CancelledError, FileAccessError, GrmmError
from ...grmm_core.jobs.progress import Share, nobody
from ...grmm_core.session import FINAL_STRANDS, CancelCheck, HairUse, Instance, RenderOptions
from .. import session_host
from ..rig.avatar import missing_file
from ..scene.shot import AvatarShot, Frame, Occluders, Region
from . import passes, picture
from .occlusion import OccluderDepths, Visibility

PLAYED_STRANDS = 0.2  # share of the strands in a frame of playback
CANCEL_POLL = 0.05  # seconds between two questions whether to stop while avatars are opened
OPENED, DRAWN = 0.1, 0.8  # of the progress: when the session begins and has ended


@dataclass(frozen=True)
class DrawSettings:
    """How a picture is made.

    Attributes:
        refine: Run the refinement network.
        lod: Level of detail, see `RenderOptions`.
        samples: Samples per pixel and direction along the edges of meshes.
        strands: See `RenderOptions`.
        coarse: See `RenderOptions`.
    """

    refine: bool = True
    lod: int = 0
    samples: int = 3
    strands: float = 1.0
    coarse: bool = False

    @staticmethod
    def final(refine: bool, lod: int, samples: int) -> DrawSettings:
        """Of a picture that may take its time: at full detail with finer hair than a view that moves."""
        return DrawSettings(refine, lod, samples, 1.0 if lod else FINAL_STRANDS)


def frame_values(
    frame: Frame,
    settings: DrawSettings,
    items: list[passes.RenderPass],
    region: Region,
    should_cancel: CancelCheck,
    progress: Share = nobody,
    depths: OccluderDepths | None = None,
    meshes: Callable[[], Occluders] | None = None,
) -> dict[str, np.ndarray]:
    """Return the values of passes, each [H, W, C] of the region, top row first.

    Args:
        frame: What to draw.
        settings: How to draw it.
        items: Passes.
        region: Part of the picture that is returned; all of it is drawn.
        should_cancel: Asked now and then.
        progress: Told where this stands.
        depths: Keeps what frames have in common; not to be used on two threads at once.
        meshes: Reads those that hide avatars, if the frame does not have them; called while the session draws.

    Raises:
        CancelledError: `should_cancel` said so.
        GrmmError: An avatar or the session cannot be used.
    """
    if should_cancel():
        raise CancelledError("The render was cancelled.")
    progress(0.0, session_host.loading("opening avatars"))
    instances = _while_asked(lambda: open_instances(frame.scene.avatars), should_cancel)
    progress(OPENED, session_host.loading(f"drawing {len(instances)} avatar{'s' if len(instances) != 1 else ''}"))
    world, hiding = frame.scene.world, None

    def begin_hiding() -> None:
        nonlocal hiding
        occluders = frame.scene.occluders if meshes is None else meshes()
        if occluders:
            hiding = (OccluderDepths() if depths is None else depths).of(occluders, frame.camera, settings.samples, frame.clip)

    hides = meshes is not None or bool(frame.scene.occluders)
    with _Beside(begin_hiding, should_cancel) as beside:
        options = _options(frame, settings, items, hides)
        buffers = session_host.get_session().render(instances, frame.camera, options, beside)
    session_host.note_drawn()
    progress(DRAWN, "putting the scene in front")
    x, y = region.x, frame.camera.height - region.y - region.height  # Blender counts rows from below
    buffers = {name: buffer[y : y + region.height, x : x + region.width] for name, buffer in buffers.items()}
    visible = Visibility()
    if hiding is not None:
        visible = hiding.visibility(buffers["depth"][..., 0], (x, y), film=world is not None)
    names = [shot.name for shot in frame.scene.avatars]
    values = {item.name: picture.pass_values(item, buffers, visible, world, names) for item in items}
    progress(1.0, "done")
    return values


def announce(frame: Frame, settings: DrawSettings, items: list[passes.RenderPass]) -> None:
    """Tell the session that `frame_values` will ask for this next; at once, also while another thread draws."""
    instances = []
    for shot in frame.scene.avatars:
        number = session_host.known_avatar(shot.source)
        if number is None or shot.cloud is not None or shot.strands is not None:
            return
        instances.append(_placed(shot, number, shot.controls, shot.hair))
    options = _options(frame, settings, items, bool(frame.scene.occluders))
    session_host.get_session().prepare(instances, frame.camera, options)


class _Beside:
    """Work for the thread that waits for the session, done when it first asks whether to stop: a worker draws meanwhile.

    What goes wrong in it must not leave the session in the middle of a call: it stops the picture, and is raised afterwards.
    """

    def __init__(self, work: Callable[[], None], should_cancel: CancelCheck) -> None:
        self._work: Callable[[], None] | None = work
        self._should_cancel = should_cancel
        self._error: Exception | None = None

    def __call__(self) -> bool:
        """What the session asks."""
        self._do()
        return self._error is not None or self._should_cancel()

    def __enter__(self) -> _Beside:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: object) -> None:
        if kind is None:
            self._do()
        if self._error is not None and (kind is None or issubclass(kind, CancelledError)):
            raise self._error

    def _do(self) -> None:
        work, self._work = self._work, None
        if work is not None:
            try:
                work()
            except Exception as error:  # noqa: BLE001 - raised again by `__exit__`
                self._error = error


def _options(frame: Frame, settings: DrawSettings, items: list[passes.RenderPass], hides: bool) -> RenderOptions:
    wanted = (*passes.session_passes(items), *(["depth"] if hides else []))
    return RenderOptions(
        refine=settings.refine, passes=tuple(dict.fromkeys(wanted)), lod=settings.lod, lighting=frame.scene.lighting,
        strands=settings.strands, coarse=settings.coarse,
    )  # fmt: skip


def _placed(shot: AvatarShot, number: int, controls: Controls, hair: HairUse) -> Instance:
    return Instance(
        number, controls, shot.model_to_world, hair=hair, response=shot.response, lighting=shot.own_light,
        wrinkles=shot.wrinkles,
    )  # fmt: skip


def open_instances(shots: Iterable[AvatarShot]) -> list[Instance]:
    """Open avatars and splat clouds in the session and place them. Errors name the object."""
    instances = []
    for shot in shots:
        missing = missing_file(shot.source) if shot.cloud is None else ""
        if missing:
            raise FileAccessError(f"{shot.name}: {missing}")
        try:
            if shot.cloud is None:
                number = session_host.open_avatar(shot.source).id
            else:
                number = session_host.open_cloud(shot.cloud.key, shot.cloud.version, shot.cloud.arrays)
            instances.append(_placed(shot, number, shot.controls.validate(), hair_of(shot)))
        except GrmmError as error:
            raise type(error)(f"{shot.name}: {error}") from error
    return instances


def _while_asked(work: Callable[[], list[Instance]], should_cancel: CancelCheck) -> list[Instance]:
    """Do this on a thread of its own: a model may take many seconds to load, and goes on loading where nobody waits for it.

    Raises:
        CancelledError: `should_cancel` said so first.
        Exception: What the work raises.
    """
    future: Future[list[Instance]] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:  # noqa: BLE001 - raised again on the thread that waits
            future.set_exception(error)

    threading.Thread(target=run, name="GRMM opening for a picture", daemon=True).start()
    while not wait([future], CANCEL_POLL).done:
        if should_cancel():
            raise CancelledError("The render was cancelled.")
    return future.result()


def hair_of(shot: AvatarShot, moves: bool = True) -> HairUse:
    """Return what an avatar wears, with its strands handed to the session.

    Args:
        shot: The avatar.
        moves: Strands stand where Blender has them in this frame; else they follow the head from how they are at rest.
    """
    strands = shot.strands
    if strands is None:
        return shot.hair
    groom = session_host.put_groom(strands.key, strands.version, strands.groom)
    return dataclasses.replace(shot.hair, groom=groom, points=strands.points if moves else None)
