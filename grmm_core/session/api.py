"""The narrow interface between the model and everything that uses it: open avatars, deform, render.

Callers (the `grmm` command, Blender, scripts) hold a `Session` and never touch torch. Two implementations behave alike and
pass one test-suite: `local.LocalSession` runs in this process, `client.WorkerSession` in an interpreter of its own, so that
Blender needs no torch and survives a crash of the model. Get one from `create_session`.

    with create_session() as session:
        avatar = session.open("default")
        controls = Controls().set_named({"jawOpen": 0.4})
        mesh = session.deform(avatar.id, controls)
        camera = Camera.orbit(512, 512)
        passes = session.render([Instance(avatar.id, controls)], camera, RenderOptions(passes=("rgb", "alpha", "depth")))

Threads: every method may be called from any thread; calls are carried out one after another.
Errors: `GrmmError` and subclasses only for what a user or the machine can cause; each message is one sentence.

Needs numpy only; imports neither torch nor anything that imports it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np

from ..controls.frame import Controls
from ..geometry.camera import Camera
from ..hair.groom import Groom
from ..splat.types import GaussianArrays
from .values import AvatarInfo, CloudArrays, Deformation, Instance, RenderOptions, SessionStatus
from .wearing import HairUse

CancelCheck = Callable[[], bool]
"""Asked now and then from the calling thread while a call runs; returning True cancels the call."""


@runtime_checkable
class Session(Protocol):
    """Opens avatars and draws them. Close it when done, or use it in a `with` block."""

    def open(self, source: str | os.PathLike[str]) -> AvatarInfo:
        """Open an avatar.

        Args:
            source: "default" for the avatar that comes with the weights, "sample:SEED" as `sample`, "library:NAME" for one of
                the package's avatars (`avatar.library`), or a `.grmm` file.
                Opening the same unchanged source again returns the same id.

        Raises:
            FileAccessError, FileFormatError: The file is missing, damaged, newer than this version, or needs weights or a
                head model that are not installed.
            SessionError: The worker cannot be started.
        """
        ...

    def sample(self, seed: int) -> AvatarInfo:
        """Open a new person drawn from the Gaussian fitted to the training identities; equal seeds give equal people."""
        ...

    def save(self, avatar_id: int, path: str | os.PathLike[str], hair: HairUse | None = None) -> None:
        """Write an opened avatar, with the hair that it wears if `hair` is given, as a `.grmm` file with a fresh thumbnail.

        Raises:
            FileAccessError: The file cannot be written.
        """
        ...

    def release(self, avatar_id: int) -> None:
        """Forget an avatar, or a cloud, and what was cached for it. Unknown ids are ignored."""
        ...

    def put_cloud(self, name: str, version: str, cloud: CloudArrays) -> int:
        """Keep Gaussians that come from elsewhere, to be drawn as an `Instance` with the id returned; controls do nothing.

        Args:
            name: Whose Gaussians these are. A cloud put under the same name before is replaced and keeps its id.
            version: Changes whenever the Gaussians do; with the version that is already there nothing is copied.
            cloud: The Gaussians.
        """
        ...

    def put_groom(self, name: str, version: str, groom: Groom) -> str:
        """Keep strands, to be worn as `HairUse(groom=what is returned)` by any avatar of the head that they stand on.

        Args:
            name: Whose strands these are. A groom put under the same name before is replaced.
            version: Changes whenever the groom does; with the version that is already there nothing is copied.
            groom: The strands, see `hair.groom` and `hair.attach`.
        """
        ...

    def deform(self, avatar_id: int, controls: Controls) -> Deformation:
        """Return the deformed mesh.

        Raises:
            ControlError, ShapeError: A control is not finite or too long for this model.
            SessionError: Unknown id.
        """
        ...

    def gaussians(
        self,
        avatar_id: int,
        controls: Controls,
        view_direction: np.ndarray | None = None,
        lod: int = 0,
        features: bool = False,
        hair: HairUse = ...,
    ) -> GaussianArrays:
        """Return the Gaussians in head space, those of the hair last.

        Args:
            avatar_id: The avatar.
            controls: Expression and pose.
            view_direction: Unit vector from the head towards the camera in head space, [3]; from the front when None.
            lod: As `RenderOptions.lod`.
            features: Also return the feature channels; without them there are 0; those of strands are zero.
            hair: What the avatar wears.

        Returns:
            Metres; colors as seen along the view direction, not refined, and where one is given without the inside of the bust.
        """
        ...

    def render(
        self,
        instances: Sequence[Instance],
        camera: Camera,
        options: RenderOptions = ...,
        should_cancel: CancelCheck | None = None,
    ) -> dict[str, np.ndarray]:
        """Draw avatars into one picture.

        All Gaussians of all instances are rasterised together in world space, so avatars occlude one another exactly.

        Args:
            instances: Avatars with controls and placement; an empty sequence gives an empty picture.
            camera: World to pixels.
            options: Passes, refinement, detail.
            should_cancel: Polled from the calling thread, for example Blender's `test_break`.

        Returns:
            One float32 array [H, W, C] for each pass asked for, top row first:

            ========  ==  ===========================================================================================
            rgb       3   display sRGB, premultiplied by alpha (over the background if one was given), refined
            alpha     1   coverage 0..1, of the avatars alone
            depth     1   camera z in metres (expected depth); `EMPTY_DEPTH` where nothing is
            raw       3   as rgb, but before the refinement network
            normal    3   mesh normals in world axes, unit length; zero where nothing is
            features  F   splatted feature channels, premultiplied by alpha
            mask      K   coverage of each of the K instances, after mutual occlusion; sums to alpha
            hair      1   coverage of the strands of all instances, part of alpha
            diffuse   3   what light inside the skin gives, linear, premultiplied; of unlit instances all of their light
            specular  3   what lit surfaces mirror, linear, premultiplied
            shadow    1   share of the lamps' light that arrives, premultiplied by alpha; all of it on unlit instances
            ========  ==  ===========================================================================================

            `grmm_core.pictures.color` converts rgb to scene-linear premultiplied (Blender) or straight alpha (PNG).

        Raises:
            ControlError, ShapeError: Bad controls.
            CancelledError: `should_cancel` returned True.
            SessionError: Unknown id, out of memory, or several workers in a row ended over it.
        """
        ...

    def prepare(self, instances: Sequence[Instance], camera: Camera, options: RenderOptions) -> None:
        """Say which picture will be asked for next, for a worker to begin with it while it draws the present one.

        Returns at once, also during a call in another thread; may do nothing, and raises nothing: `render` does. A session in
        this process has no cores to spare for it.

        Args:
            instances: As `render`.
            camera: As `render`.
            options: As `render`.
        """
        ...

    def at_once(self, seconds: float) -> AbstractContextManager[bool]:
        """Tell whether calls of this thread within the block are carried out at once, after waiting for that so long.

        They are where the model is loaded and no other thread's call is under way; until the block ends none begins then. Other
        calls wait for as long as it takes, which is half a minute and more where a first picture is being compiled for.
        """
        ...

    def warm_up(self) -> None:
        """Start loading the model in the background and return at once; a failure shows at the next call."""
        ...

    def status(self) -> SessionStatus:
        """Return what runs the model; never starts a worker."""
        ...

    def close(self) -> None:
        """Free everything; a worker process ends. Further calls raise `SessionError`; closing twice is harmless."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None: ...
