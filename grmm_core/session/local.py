"""`LocalSession`: the session interface, carried out in this process.

Used directly by the command line and scripts, and inside the worker process by `worker`. What it computes with is its engine.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import platform
import threading
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Concatenate, ParamSpec, Self, TypeVar

import numpy as np

from ..avatar import save_avatar
from ..compute.memory import resident_memory
from ..controls.frame import Controls
from ..errors import SessionError, ShapeError
from ..geometry.camera import Camera
from ..geometry.libraries import present, to_numpy
from ..geometry.rotations import euler_to_matrix
from ..hair.groom import Groom
from ..head.skinning import joint_transforms
from ..model.portrait import THUMBNAIL_PIXELS, portrait_camera
from ..pictures.color import straight_rgba
from ..pictures.images import encode_png, quantize
from ..splat.types import GaussianArrays
from .api import CancelCheck
from .clouds import OpenCloud
from .compose import Gathered, PlacedAvatar, PlacedCloud, draw, gather
from .engines import Engine
from .evaluator import Evaluator, Inputs, OpenAvatar
from .holding import held
from .opened import OpenAvatars
from .painter import painted
from .photo_skin import unpainted
from .sources import SourceKey, source_key
from .values import MAX_LOD, AvatarInfo, CloudArrays, Deformation, Instance, RenderOptions, SessionStatus, check_render_size
from .wardrobe import Wardrobe
from .wearing import HairUse

CACHE_BYTES = 512 << 20
_UNIT_TOLERANCE = 1e-3
_PATIENCE = 1.0  # seconds that `begin` waits for the picture before

P = ParamSpec("P")
R = TypeVar("R")


def _guarded(
    method: Callable[Concatenate[LocalSession, P], R],
) -> Callable[Concatenate[LocalSession, P], R]:
    """Let one call through at a time, and nothing else at what is kept from call to call."""

    @functools.wraps(method)
    def call(self: LocalSession, /, *args: P.args, **kwargs: P.kwargs) -> R:
        with self._calling(), self._keeping:
            return method(self, *args, **kwargs)

    return call


class LocalSession:
    """Opens and draws avatars in this process. See `api.Session` for the methods.

    Args:
        engine: What computes; weights are read by the first call or `warm_up`.
        cache_bytes: Limit of what is kept between calls (see `evaluator`).

    Attributes:
        evaluator: Computes meshes and Gaussians; its cache is the session's.
    """

    def __init__(self, engine: Engine, cache_bytes: int = CACHE_BYTES) -> None:
        self._lock = threading.RLock()  # of a call
        self._keeping = threading.RLock()  # of evaluator and wardrobe, which `begin` uses beside a call
        self._stage = threading.Condition()
        self._drawing = False  # a picture is drawn or done, whose Gaussians are made: there is time for the next one's
        self._asked = ""  # name of the last picture that was begun with, or is too late for it
        self._begun: tuple[Gathered, Camera, RenderOptions] | None = None  # what was made of it
        self._drawn: tuple[str, dict[str, np.ndarray]] | None = None  # the picture of that name, before it is asked for
        self._closed = False
        self.engine = engine
        self.evaluator = Evaluator(engine, cache_bytes)
        self._wardrobe = Wardrobe(engine)
        self._opened = OpenAvatars(engine, self.evaluator)
        self._clouds: dict[int, OpenCloud] = {}

    @contextlib.contextmanager
    def _calling(self) -> Iterator[None]:
        """Surrounds a call: one at a time; an exhausted memory becomes one sentence."""
        with self._lock:
            if self._closed:
                raise SessionError("The session is closed; open a new one.")
            try:
                with self.engine.calling():
                    yield
            except MemoryError as error:
                self.evaluator.cache.clear()
                raise SessionError("The model ran out of memory; choose a smaller size or a higher level of detail.") from error

    @_guarded
    def open(self, source: str | os.PathLike[str]) -> AvatarInfo:
        """See `Session.open`."""
        return self._opened.open(source_key(source))

    @_guarded
    def sample(self, seed: int) -> AvatarInfo:
        """See `Session.sample`."""
        return self._opened.open(SourceKey("sample", str(int(seed))))

    @_guarded
    def save(self, avatar_id: int, path: str | os.PathLike[str], hair: HairUse | None = None) -> None:
        """See `Session.save`."""
        target = self.target(avatar_id)
        avatar = target.avatar
        if hair is not None:
            worn = self._wardrobe.worn(target, hair)
            if worn is not None and worn.gone is not None:
                avatar = dataclasses.replace(avatar, deltas=unpainted(self.evaluator, target, worn.gone))
            avatar = dataclasses.replace(avatar, hair=self._wardrobe.kept(target, hair))
        buffers = self.render([Instance(avatar_id, hair=hair or HairUse())], portrait_camera(THUMBNAIL_PIXELS))
        png = encode_png(quantize(straight_rgba(buffers["rgb"], buffers["alpha"])))
        painting = avatar.painting
        if not painting.size:
            painting = painted(self, avatar_id, target.model.head_model)
        save_avatar(avatar.with_pictures(png, painting), path)

    @_guarded
    def release(self, avatar_id: int) -> None:
        """See `Session.release`."""
        self._opened.release(avatar_id)
        self._clouds.pop(avatar_id, None)

    @_guarded
    def put_cloud(self, name: str, version: str, cloud: CloudArrays) -> int:
        """See `Session.put_cloud`."""
        known = next((cloud for cloud in self._clouds.values() if cloud.name == name), None)
        number = self._opened.next_number() if known is None else known.id
        if known is None or known.version != version:
            self._clouds[number] = OpenCloud.make(number, name, version, cloud, self.engine)
        return number

    @_guarded
    def put_groom(self, name: str, version: str, groom: Groom) -> str:
        """See `Session.put_groom`."""
        return self._wardrobe.put(name, version, groom)

    @_guarded
    def deform(self, avatar_id: int, controls: Controls) -> Deformation:
        """See `Session.deform`."""
        target = self.target(avatar_id)
        inputs = self.evaluator.inputs(target, controls)
        with self.engine.one_thread():
            mesh = self.evaluator.mesh(target, inputs)
        return Deformation(to_numpy(mesh.vertices), to_numpy(mesh.displacement), _joints(target, inputs))

    @_guarded
    def gaussians(
        self,
        avatar_id: int,
        controls: Controls,
        view_direction: np.ndarray | None = None,
        lod: int = 0,
        features: bool = False,
        hair: HairUse = HairUse(),  # noqa: B008 - frozen
    ) -> GaussianArrays:
        """See `Session.gaussians`."""
        target = self.target(avatar_id)
        if not 0 <= lod <= MAX_LOD:
            raise ShapeError(f"The level of detail is {lod}; it must be 0 to {MAX_LOD}.")
        view = None if view_direction is None else np.asarray(view_direction, np.float64)
        if view is not None and (view.shape != (3,) or not abs(np.linalg.norm(view) - 1.0) < _UNIT_TOLERANCE):
            raise ShapeError("The view direction must be a unit vector of three numbers.")
        inputs = self.evaluator.inputs(target, controls)
        found = self._wardrobe.dressed(self.evaluator, target, inputs, self._wardrobe.worn(target, hair), view, lod)
        extra = present(found.features)[:, : None if features else 0]
        return GaussianArrays(*map(to_numpy, (found.means, found.quats, found.scales, found.opacities, found.colors, extra)))

    def render(
        self,
        instances: Sequence[Instance],
        camera: Camera,
        options: RenderOptions = RenderOptions(),  # noqa: B008 - frozen
        should_cancel: CancelCheck | None = None,
        begun: str = "",
    ) -> dict[str, np.ndarray]:
        """See `Session.render`; `begun` names what `begin` was given, if it was."""
        check_render_size(camera)
        with self._calling():
            drawn, self._drawn = self._drawn, None
            done = drawn is not None and drawn[0] == begun
            self._set_drawing(done)
            if drawn is not None and done:
                return drawn[1]
            with self._keeping:
                ready = self._begun if begun and self._asked == begun else None
                if begun:
                    self._asked, self._begun = begun, None
                gathered = ready[0] if ready else self._gathered(instances, camera, options, should_cancel)
            return self._draw(gathered, camera, options, should_cancel)

    def draw_ahead(self) -> None:
        """Draw what `begin` has made ready, if it has, for `render` to hand out: while its caller is busy with the last one."""
        with self._calling():
            with self._keeping:
                ready, self._begun = self._begun, None
                name = self._asked
            if ready is not None:
                self._drawn = name, self._draw(*ready)

    def _draw(
        self, gathered: Gathered, camera: Camera, options: RenderOptions, should_cancel: CancelCheck | None = None
    ) -> dict[str, np.ndarray]:
        self._set_drawing(True)
        try:
            return draw(gathered, self.evaluator, camera, options, should_cancel)
        finally:
            self._set_drawing(False)

    def prepare(self, instances: Sequence[Instance], camera: Camera, options: RenderOptions) -> None:
        """See `Session.prepare`."""

    def begin(self, name: str, instances: Sequence[Instance], camera: Camera, options: RenderOptions) -> None:
        """Make the Gaussians of the picture that `render` will be asked for next, on another thread than its own.

        Args:
            name: What `render` will be told as `begun`.
            instances: As `render`.
            camera: As `render`.
            options: As `render`.

        Raises:
            GrmmError: As `render`, which will raise it too.
        """
        with self._stage:  # the present picture goes first
            self._stage.wait_for(lambda: self._drawing or self._asked == name, _PATIENCE)
        with self._keeping, self.engine.calling():
            if not self._closed and self._asked != name:
                self._asked, self._begun = name, (self._gathered(instances, camera, options), camera, options)

    def _set_drawing(self, value: bool) -> None:
        with self._stage:
            self._drawing = value
            self._stage.notify_all()

    def _gathered(
        self, instances: Sequence[Instance], camera: Camera, options: RenderOptions, should_cancel: CancelCheck | None = None
    ) -> Gathered:
        placed: list[PlacedAvatar | PlacedCloud] = []
        for instance in instances:
            if instance.avatar_id in self._clouds:
                placed.append(PlacedCloud(self._clouds[instance.avatar_id], instance))
                continue
            target = self.target(instance.avatar_id)
            worn = self._wardrobe.worn(target, instance.hair)
            placed.append(PlacedAvatar(target, self.evaluator.inputs(target, instance.controls), instance, worn))
        return gather(placed, self.evaluator, self._wardrobe, camera, options, should_cancel)

    @contextlib.contextmanager
    def at_once(self, seconds: float) -> Iterator[bool]:
        """See `Session.at_once`."""
        with held(self._lock, seconds) as free:
            yield free and len(self._opened) > 0

    @_guarded
    def warm_up(self) -> None:
        """See `Session.warm_up`; here it loads and compiles before it returns, because threads would share one interpreter."""
        info = self.open("default")
        self.render([Instance(info.id)], Camera.orbit(64, 64), RenderOptions(passes=("rgb", "alpha")))

    def status(self) -> SessionStatus:
        """See `Session.status`."""
        return SessionStatus(
            kind="local", alive=not self._closed, pid=os.getpid(), python=platform.python_version(), engine=self.engine.name,
            torch=self.engine.torch, device=self.engine.device, threads=self.engine.threads, memory_bytes=resident_memory(),
        )  # fmt: skip

    def close(self) -> None:
        """See `Session.close`."""
        with self._lock:
            self._closed = True
            self._opened.clear()
            self._clouds.clear()
            self.evaluator.cache.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def target(self, avatar_id: int) -> OpenAvatar:
        """Return an avatar with its model, for measurements in this process. Raises `SessionError`."""
        return self._opened.target(avatar_id)


def _joints(target: OpenAvatar, inputs: Inputs) -> np.ndarray:
    """Return posed joint positions, [5, 3]."""
    head = target.model.head_model
    rest = np.asarray(head.joints(inputs.shape), np.float32)
    transforms = joint_transforms(euler_to_matrix(inputs.pose), rest, head.parents.tolist())  # [5, 3, 4]
    return ((transforms[..., :3] @ rest[..., None])[..., 0] + transforms[..., 3]).astype(np.float32)
