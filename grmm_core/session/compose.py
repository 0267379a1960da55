"""One picture of several avatars: rasterise together, refine, hand out passes.

All Gaussians are brought into camera space and rasterised in one pass, so that avatars occlude one another to the last
splat. Further channels ride along with the features: mesh normals for the "normal" pass and, for several avatars, one channel
each that holds 1 on its own Gaussians, whose splatted value is that avatar's coverage after occlusion.

One text for every engine: its arrays are numpy's or torch's. Called by `local`.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import CancelledError
from ..geometry.camera import Camera
from ..geometry.libraries import Array, as_like, present, to_numpy, zeros
from ..geometry.rotations import matrix_to_quaternion, multiply_quaternions
from ..hair.ribbons import Eye
from ..light.lamps import Lighting
from ..light.mesh_light import LitSurface
from ..light.relight import relit, relit_pixels
from ..light.skin_relief import softened
from ..model.steps import HEAD_CENTRE
from ..model.store import Model
from ..splat.compensation import filtered
from ..splat.types import Gaussians, RasterOutput
from ..wrinkles.furrows import Furrows
from .api import CancelCheck
from .clouds import OpenCloud
from .evaluator import Evaluator, Inputs, OpenAvatar, at_rest
from .furrowed import furrows_of, with_furrows
from .hollow import without_inside
from .lit import HIGHLIGHTS, LIGHT_CHANNELS, RATIO, SHADOW, UNLIT, LitAvatar
from .mutual_shadows import mutual_shadows
from .passes import Channels, buffers, empty, light_of
from .refining import refine
from .shading_hair import Hair
from .stacking import with_light
from .values import LIGHT_PASSES, LINEAR_PASS, Instance, RenderOptions
from .wardrobe import Wardrobe, Worn

NORMAL_CHANNELS = 3
_FAR_SIDE = 0.05  # metres behind the skin, which lets a little of what is nearer through; a frame of playback has no more


@dataclass(frozen=True)
class PlacedAvatar:
    """An instance of an avatar, with what `local` looked up for it; `worn` is None where its hair is in its Gaussians alone."""

    target: OpenAvatar
    inputs: Inputs
    instance: Instance
    worn: Worn | None = None

    @property
    def model(self) -> Model:
        """The network that the Gaussians come from."""
        return self.target.model


@dataclass(frozen=True)
class PlacedCloud:
    """An instance of a cloud, which no network touches."""

    target: OpenCloud
    instance: Instance
    model: None = None


Placed = PlacedAvatar | PlacedCloud


@dataclass(frozen=True)
class Gathered:
    """What a picture is drawn from: the instances, their Gaussians, lit meshes and furrows, and what channels mean."""

    placed: Sequence[Placed]
    parts: list[Gaussians]
    surfaces: list[LitSurface | None]
    furrows: list[tuple[Furrows, Camera]]
    channels: Channels


def gather(
    placed: Sequence[Placed],
    evaluator: Evaluator,
    wardrobe: Wardrobe,
    camera: Camera,
    options: RenderOptions,
    should_cancel: CancelCheck | None = None,
) -> Gathered:
    """Make the Gaussians of a picture, its first half. Call within `Engine.calling`."""
    check = _canceller(should_cancel)
    check()
    channels = _plan(placed, options)
    gathered = Gathered(placed, [], [], [], channels)
    shadows: list[np.ndarray | None] = [None] * len(placed)
    if channels.light is not None:
        bodies = (
            (item.target, item.inputs, item.instance.model_to_world) if isinstance(item, PlacedAvatar) else None
            for item in placed
        )
        shadows = mutual_shadows(list(bodies), evaluator)
    for index, item in enumerate(placed):
        own, surface = _gaussians(item, index, evaluator, wardrobe, camera, options, channels, shadows[index], len(placed) == 1)
        gathered.parts.append(own)
        gathered.surfaces.append(surface)
        if isinstance(item, PlacedAvatar) and not _is_played(options):
            local, light = camera.transformed(item.instance.model_to_world), functools.partial(_lighting, item, options)
            found = furrows_of(evaluator, item.target, item.inputs, item.instance.wrinkles, light)
            if found is not None:
                gathered.furrows.append((found, local))
        check()
    return gathered


def draw(
    gathered: Gathered, evaluator: Evaluator, camera: Camera, options: RenderOptions, should_cancel: CancelCheck | None
) -> dict[str, np.ndarray]:
    """Draw what was gathered, the second half; see `api.Session.render` for the result. Uses nothing that `gather` keeps."""
    check = _canceller(should_cancel)
    placed, parts, channels = gathered.placed, gathered.parts, gathered.channels
    if not placed:
        return empty(camera, options)
    halved = channels.last if options.coarse and "features" not in options.passes else 0
    if len(placed) == 1:
        # In head space as it is: the placement goes into the camera (eq. 2) and no Gaussian is moved.
        raster = evaluator.engine.rasterize(parts[0], camera.transformed(placed[0].instance.model_to_world), halved)
    else:
        raster = evaluator.engine.rasterize(Gaussians.concatenate(parts), _at_origin(camera), halved)
    check()
    refined = raster.rgb
    if _refines(options):
        refined = refine([item.model for item in placed], raster, channels, options, check)
    refined = with_furrows(gathered.furrows, refined, raster, channels.skin)
    if channels.light is not None:
        raster = _read_from_meshes(gathered, raster, camera)
        refined = _relit(refined, raster, channels.light)
    return buffers(raster, refined, channels, options, evaluator.engine)


def _read_from_meshes(gathered: Gathered, raster: RasterOutput[Any], camera: Camera) -> RasterOutput[Any]:
    """The picture with the light of skin as its mesh has it at each pixel."""
    channels = gathered.channels
    if channels.light is None or not any(gathered.surfaces):
        return raster
    features, depth = to_numpy(present(raster.features)), to_numpy(raster.depth)
    alpha = to_numpy(raster.alpha)
    for item, surface in zip(gathered.placed, gathered.surfaces, strict=True):
        if surface is not None:
            local = camera.transformed(item.instance.model_to_world)
            surface.read_into(features, channels.light, depth, alpha, channels.skin, local)
    return dataclasses.replace(raster, features=as_like(features, present(raster.features)))


def _relit(refined: Any, raster: RasterOutput[Any], which: slice) -> Any:
    if isinstance(refined, np.ndarray) or refined.device.type == "cpu":  # one compiled pass instead of twenty of torch
        light = to_numpy(present(raster.features))
        return as_like(relit_pixels(to_numpy(refined), to_numpy(raster.alpha), light, which.start), refined)
    light = light_of(raster, which)
    return relit(refined, raster.alpha, light[..., RATIO], light[..., HIGHLIGHTS])


def _canceller(should_cancel: CancelCheck | None) -> Callable[[], None]:
    def check() -> None:
        if should_cancel is not None and should_cancel():
            raise CancelledError("The picture was cancelled.")

    return check


def _refines(options: RenderOptions) -> bool:
    shown = ("rgb", LINEAR_PASS, *LIGHT_PASSES)
    return options.refine and any(name in options.passes for name in shown)


def _plan(placed: Sequence[Placed], options: RenderOptions) -> Channels:
    """Where channels are: features last and none that strands have, which the rasteriser then need not sum."""
    wants_features = "features" in options.passes or _refines(options)
    count = 0
    skin = None
    worn = [item.worn for item in placed if isinstance(item, PlacedAvatar)]
    strands = any(one is not None and one.layers for one in worn)
    lit = any(_is_lit(item, options) for item in placed)
    if strands and (lit or wants_features or "hair" in options.passes):
        skin = count
        count += 1
    light = None
    if lit:
        light = slice(count, count + (LIGHT_CHANNELS if "shadow" in options.passes else SHADOW.start))
        count = light.stop
    coverage = None
    if len(placed) > 1 and (wants_features or "mask" in options.passes):
        coverage = slice(count, count + len(placed))
        count = coverage.stop
    normals = None
    if "normal" in options.passes:
        normals = slice(count, count + NORMAL_CHANNELS)
        count = normals.stop
    features: dict[int, slice] = {}
    if wants_features:
        for item in placed:
            key = id(item.model)
            if item.model is not None and key not in features:
                features[key] = slice(count, count + item.model.config.features)
                count = features[key].stop
    return Channels(features, normals, coverage, skin, light, count)


def _is_played(options: RenderOptions) -> bool:
    return options.coarse and options.strands < 1.0


def _is_lit(item: Placed, options: RenderOptions) -> bool:
    there = options.lighting is not None or item.instance.lighting is not None
    return there and item.instance.response is not None and isinstance(item, PlacedAvatar)


def _gaussians(
    item: Placed, index: int, evaluator: Evaluator, wardrobe: Wardrobe, camera: Camera, options: RenderOptions,
    channels: Channels, shadows: np.ndarray | None, single: bool,
) -> tuple[Gaussians, LitSurface | None]:  # fmt: skip
    """Return one instance's Gaussians with all channels: in head space when it is alone, else in camera space.

    And its mesh with its light, in head space, where it is lit.
    """
    model_to_world = item.instance.model_to_world
    local_camera = camera.transformed(model_to_world)
    strands = hiding = surface = None
    played = _is_played(options)
    if isinstance(item, PlacedCloud):
        own = item.target.seen_from(local_camera, options.lod)
    else:
        direction = local_camera.view_direction(np.array(HEAD_CENTRE))
        cap, lit = None, _is_lit(item, options)
        if played or (item.worn is not None and item.worn.layers):
            hiding = wardrobe.hiding(evaluator, item.target, item.inputs, local_camera)
        if item.worn is not None:
            cap = wardrobe.cap(evaluator, item.target, item.inputs, item.worn, lit)
            strands = wardrobe.gaussians(
                evaluator, item.target, item.inputs, item.worn, local_camera, options.lod, options.strands, hiding=hiding
            )
        own = evaluator.gaussians(item.target, item.inputs, direction, options.lod, cap, lit, not lit)
        own = without_inside(own, evaluator, item.target, item.inputs, options.lod, local_camera)
    count = len(own)
    features = own.features
    if item.model is not None and item.model.config.antialias:
        own = filtered(own, local_camera, np.array(HEAD_CENTRE))
    if played and hiding is not None:
        seen = np.ones(count, np.float32)
        hiding.hide(to_numpy(own.means), Eye.of(local_camera).numbers(), seen, _FAR_SIDE)
        own = dataclasses.replace(own, opacities=own.opacities * as_like(seen, own.opacities))
    if strands is not None:
        own = Gaussians.concatenate([dataclasses.replace(part, features=None) for part in (own, strands)])
    own_slice = None if item.model is None else channels.features.get(id(item.model))
    light: list[np.ndarray] = []
    if channels.light is not None:
        light, surface = _light(item, evaluator, wardrobe, local_camera, options, strands, len(own), shadows)
    if channels.count == 0:
        stacked = None
    elif strands is None and own_slice is not None and own_slice == slice(0, channels.count):
        stacked = features
    elif own_slice is not None and isinstance(item, PlacedAvatar) and not channels.vary:
        ones = [] if channels.skin is None else [channels.skin]
        stacked = evaluator.with_channels(item.target, present(features), own_slice, ones, channels.count, len(own))
    elif channels.light is not None and channels.normals is None and channels.coverage is None:
        skin = present(features) if own_slice is not None else own.means[:count]
        stacked = with_light(skin, own_slice, channels.skin, light, channels.light, channels.count)
    else:
        stacked = zeros((len(own), channels.count), own.means)
        if own_slice is not None:
            stacked[:count, own_slice] = present(features)
        if channels.normals is not None and isinstance(item, PlacedAvatar):
            normals = evaluator.normals(item.target, item.inputs, options.lod)
            rotation = _rotation(model_to_world, normals)
            stacked[:count, channels.normals] = normals @ rotation.T
        if channels.coverage is not None:
            stacked[:, channels.coverage.start + index] = 1.0
        if channels.skin is not None:
            stacked[:count, channels.skin] = 1.0
        if channels.light is not None:
            lit = np.concatenate(light)[:, : channels.light.stop - channels.light.start]
            stacked[:, channels.light] = evaluator.engine.array(lit)
    means, quats, scales = own.means, own.quats, own.scales
    if not single:
        to_camera = camera.world_to_camera @ model_to_world
        size = float(np.cbrt(np.linalg.det(to_camera[:3, :3])))
        linear = as_like(to_camera[:3, :3], means)
        means = means @ linear.T + as_like(to_camera[:3, 3], means)
        quats = multiply_quaternions(as_like(matrix_to_quaternion(to_camera[:3, :3] / size), quats), quats)
        scales = scales * size
    return Gaussians(means, quats, scales, own.opacities, own.colors, stacked), surface


def _lighting(item: PlacedAvatar, options: RenderOptions, shadows: np.ndarray | None = None) -> Lighting | None:
    """The light of one instance in its head space, also where `shadows` [T, 3, 3] of others fall on it; None: the studio's."""
    response, own = item.instance.response, item.instance.lighting
    if own is None and response is not None and options.lighting is not None:
        scene = options.lighting if shadows is None else options.lighting.and_occluders(shadows)
        own = scene.without(response.unlit_by).in_space(np.linalg.inv(item.instance.model_to_world))
    return own if response is not None else None


def _light(
    item: Placed, evaluator: Evaluator, wardrobe: Wardrobe, camera: Camera, options: RenderOptions,
    strands: Gaussians | None, count: int, shadows: np.ndarray | None,
) -> tuple[list[np.ndarray], LitSurface | None]:  # fmt: skip
    """What light does to one instance: its Gaussians in parts of [N, LIGHT_CHANNELS], and its mesh; nothing where unlit."""
    response = item.instance.response
    own = None if isinstance(item, PlacedCloud) else _lighting(item, options, shadows)
    if isinstance(item, PlacedCloud) or response is None or own is None:
        return [np.tile(UNLIT, (count, 1))], None
    hair = None
    if item.worn is not None and item.worn.layers:
        settings = item.worn.settings[0]
        given = tuple(hashlib.sha256(layer.points.tobytes()).digest() for layer in item.worn.layers if layer.points is not None)
        inputs = item.inputs if given else at_rest(item.target, item.inputs)
        pieces = functools.partial(wardrobe.covering, evaluator, item.target, inputs, item.worn)
        hair = Hair((*item.worn.key, settings, *given), pieces, bool(given))
    relief = softened(Eye.of(camera).pixels_per_metre())
    lit = LitAvatar(evaluator, item.target, item.inputs, own, response, options.lod, hair, relief)
    channels = lit.channels(camera.position, strands)
    return channels, lit.surface(channels[0])


def _rotation(model_to_world: np.ndarray, like: Array) -> Array:
    linear = model_to_world[:3, :3]
    return as_like(linear / np.cbrt(np.linalg.det(linear)), like)


def _at_origin(camera: Camera) -> Camera:
    """Return the camera of points that are given in its own axes."""
    return Camera(
        np.eye(4), camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, orthographic=camera.orthographic
    )
