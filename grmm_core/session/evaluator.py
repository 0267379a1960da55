"""The model's forward chain behind a cache: an avatar and its controls to mesh and Gaussians, computing only what changed.

The steps are those of `model.grmm`. What each depends on, and so what its cache key holds (the owner is the avatar):

=============  ==============================================
opacity        identity code
appearance     identity code, view direction (to the last bit)
offsets        identity code, expression code
tint           identity code, expression code
turned shade   what mesh depends on
eye shade      likewise
rest           shape
mesh           identity code, expression code, shape, expression, pose, strength
geometry       what mesh and offsets depend on
=============  ==============================================

So a moving camera decodes appearance alone, an animated expression everything but opacity and appearance, and a still of the
same frame nothing. One text for every engine: its arrays are
numpy's or torch's. Called by `local` and `compose`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..avatar import Avatar
from ..controls.frame import Controls
from ..geometry.libraries import to_numpy, zeros
from ..light.resting import Texels
from ..light.tones import Tones
from ..light.turning import turned_shade
from ..model.detail import Blocks, texel_blocks, thin_out
from ..model.inputs import ModelInputs
from ..model.steps import Geometry, Mesh, Rest
from ..model.store import LoadedModel, Model
from ..splat import Gaussians
from .cache import ArrayCache
from .cap import Cap, Laid
from .engines import Engine
from .sources import SourceKey

Inputs = ModelInputs[np.ndarray]
FRONT = np.array([0.0, 0.0, 1.0])  # towards a camera in front of the face, head space
_SPARE_ROWS = 4096  # of zeros, by which the channels of skin and strands grow


@dataclass(frozen=True)
class OpenAvatar:
    """An avatar together with the model that draws it.

    Attributes:
        id: Handle in the session; owner of its cache entries.
        avatar: Codes and shape.
        loaded: Model (with the avatar's own weight changes, if it has any).
        source: What it was opened from.
    """

    id: int
    avatar: Avatar
    loaded: LoadedModel[Any]
    source: SourceKey

    @property
    def model(self) -> Model:
        """The network."""
        model: Model = self.loaded.model
        return model

    @functools.cached_property
    def still(self) -> Inputs:
        """What it is drawn from without controls."""
        return self.loaded.space.inputs(self.avatar, Controls())

    @functools.cached_property
    def tones(self) -> Tones:
        """What colors that were learned lack, such as the shade of lids."""
        head, layout, config = self.model.head_model, self.model.layout, self.model.config
        texels = Texels.of(head, layout.face, layout.barycentric)
        return Tones.of(head, texels, config.eye_shade, config.mouth_tone)


class Evaluator:
    """Computes meshes and Gaussians of open avatars through one bounded cache. Call within `Engine.calling`."""

    def __init__(self, engine: Engine, cache_bytes: int) -> None:
        self.engine = engine
        self.cache = ArrayCache(cache_bytes)

    def inputs(self, target: OpenAvatar, controls: Controls) -> Inputs:
        """Add the avatar's own codes to the controls. Raises as `InputSpace.inputs`."""
        return target.loaded.space.inputs(target.avatar, controls)

    def mesh(self, target: OpenAvatar, inputs: Inputs) -> Mesh[Any]:
        """Return posed vertices and the learned displacement, both [V, 3] metres."""

        def make() -> Mesh[Any]:
            # Most expressions are zero from some component on: what they would add is not computed.
            used = int(np.flatnonzero(inputs.expression)[-1]) + 1 if inputs.expression.any() else 0
            short = dataclasses.replace(inputs, expression=inputs.expression[:used])
            return target.model.mesh(short.mapped(self.engine.array), self.rest(target, inputs))

        return self.cache.get((target.id, "mesh", *inputs.mesh_key), make)

    def rest(self, target: OpenAvatar, inputs: Inputs) -> Rest[Any]:
        """Return the shaped head without expression."""

        def make() -> Rest[Any]:
            return target.model.rest(self.engine.array(inputs.shape))

        return self.cache.get((target.id, "rest", *inputs.shape_key), make)

    def geometry(self, target: OpenAvatar, inputs: Inputs, flat: Any = None) -> Geometry[Any]:
        """Return the placed Gaussians in head space; where `flat` [N] is 1, on the skin without what was learned."""

        def make() -> Geometry[Any]:
            offsets = self.offsets(target, inputs)
            offsets = offsets if flat is None else offsets * (1.0 - flat)[:, None]
            return target.model.geometry(self.mesh(target, inputs).vertices, offsets)

        laid = None if flat is None else hash(to_numpy(flat).tobytes())  # by what is worn, not only whether
        return self.cache.get((target.id, "geometry", laid, *inputs.mesh_key), make)

    def offsets(self, target: OpenAvatar, inputs: Inputs) -> Any:
        """Return Phi_T's offsets, [N, 10]."""
        return self._decoded(target, "offsets", inputs, inputs.code_key, inputs.z_exp)[0]

    def tint(self, target: OpenAvatar, inputs: Inputs) -> Any:
        """Return what the expression adds to the colors, [N, 3] or one row of zeros."""
        return self._decoded(target, "expression_colors", inputs, inputs.code_key, inputs.z_exp)[0]

    def opacity(self, target: OpenAvatar, inputs: Inputs) -> Any:
        """Return Phi_alpha's opacities, [N]."""
        return self._decoded(target, "opacity", inputs, inputs.identity_key)[0]

    def appearance(self, target: OpenAvatar, inputs: Inputs, direction: np.ndarray) -> tuple[Any, Any]:
        """Return Phi_app's colors [N, 3] and features [N, F] for a unit view direction [3] in head space."""
        direction = np.asarray(direction, np.float32)
        key = (*inputs.identity_key, direction.tobytes())
        colors, features = self._decoded(target, "appearance", inputs, key, direction)
        return colors, features

    def gaussians(
        self, target: OpenAvatar, inputs: Inputs, direction: np.ndarray, lod: int = 0, cap: Cap | None = None,
        lit_later: bool = False, catchlight: bool = False,
    ) -> Gaussians:  # fmt: skip
        """Return all Gaussians in head space, hair laid flat where there is a cap; features are [N, F], also where F is 0.

        A catchlight is for pictures: it moves with the viewer faster than harmonics can say, and would lie on pupils as a veil.

        They are in the studio's light, or as it falls on a head at rest where a scene's light is to take its place later.
        Colors are 0..1: beyond it, as learned on very fair skin, they would cancel out here and clip in every other renderer.
        """
        colors, features = self.appearance(target, inputs, direction)
        opacities, tint = self.opacity(target, inputs), self.tint(target, inputs)
        if cap is not None:
            laid = self._laid(target, cap, colors, opacities, features)
            colors, opacities, features, tint = laid.colors, laid.opacities, laid.features, tint * laid.left
        placed = self.geometry(target, inputs, None if cap is None else cap.share)
        colors = colors + tint
        shade = None if lit_later or not target.model.config.turned_light else self.turned_shade(target, inputs)
        colors = colors if shade is None else colors * shade
        shade = self.tone(target, inputs)
        colors = colors if shade is None else colors * shade
        if (eyes := target.tones.eyes) is not None and catchlight:
            rows, vertices = eyes.texels, to_numpy(self.mesh(target, inputs).vertices)
            colors[rows] = self.engine.array(
                eyes.glinting(to_numpy(colors[rows]), target.model.head_model, vertices, direction)
            )
        colors = colors.clip(0.0, 1.0)
        full = Gaussians(*placed, opacities, colors, features)
        return full if lod == 0 else thin_out(full, self.blocks(target, lod), lod)

    def turned_shade(self, target: OpenAvatar, inputs: Inputs) -> Any:
        """Return what the turn of the neck makes of colors in the studio's light, [N, 1]; None where it does not turn."""

        def make() -> tuple[Any, ...]:
            head, vertices = target.model.head_model, to_numpy(self.mesh(target, inputs).vertices)
            shade = turned_shade(head, self.texels(target), vertices, inputs.pose)
            return () if shade is None else (self.engine.array(shade),)

        found = self.cache.get((target.id, "turned shade", *inputs.mesh_key), make)
        return found[0] if found else None

    def tone(self, target: OpenAvatar, inputs: Inputs) -> Any:
        """Return what colors of eyes and mouths are multiplied by, [N, 1 or 3]; None for models without such shades."""

        def make() -> tuple[Any, ...]:
            shade = target.tones.shade(to_numpy(self.mesh(target, inputs).vertices))
            return () if shade is None else (self.engine.array(shade),)

        found = self.cache.get((target.id, "tone", *inputs.mesh_key), make)
        return found[0] if found else None

    def texels(self, target: OpenAvatar) -> Texels:
        """Return where the Gaussians are on the mesh."""
        layout = target.model.layout
        make = functools.partial(Texels.of, target.model.head_model, layout.face, layout.barycentric)
        return Texels(*self.cache.get((target.id, "texels"), make))

    def with_channels(self, target: OpenAvatar, features: Any, at: slice, ones: Sequence[int], count: int, rows: int) -> Any:
        """Return features [N, F] as the channels `at` of [rows, count], the channels `ones` 1, and zeros; not to be written to.

        It is kept until there are other features: from frame to frame only the number of rows of zeros changes.
        """
        more = -(-(rows - len(features)) // _SPARE_ROWS) * _SPARE_ROWS

        def make() -> tuple[Any]:
            channels = zeros((len(features) + more, count), features)
            channels[: len(features), at] = features
            for one in ones:
                channels[: len(features), one] = 1.0
            return (channels,)

        return self.cache.latest((target.id, "channels", at.start, *ones, count, more), (features,), make)[0][:rows]

    def _laid(self, target: OpenAvatar, cap: Cap, *learned: Any) -> Laid:
        """What a cap makes of colors, opacities and features, which stay the same while an expression is played."""
        return self.cache.latest((target.id, "laid"), (*cap, *learned), lambda: cap.laid(*learned))

    def normals(self, target: OpenAvatar, inputs: Inputs, lod: int = 0) -> Any:
        """Return the outward mesh normal at each Gaussian, head space, [N, 3]."""

        def make() -> tuple[Any]:
            return (target.model.normals(self.mesh(target, inputs).vertices),)

        normals = self.cache.get((target.id, "normals", *inputs.mesh_key), make)[0]
        return normals if lod == 0 else normals[self.blocks(target, lod)[0]]

    def blocks(self, target: OpenAvatar, lod: int) -> Blocks:
        """Return the blocks of texels that `thin_out` merges."""
        return self.cache.get(
            (target.id, "blocks", lod), lambda: texel_blocks(target.model.texels(), target.model.config.grid, lod)
        )

    def _decoded(
        self, target: OpenAvatar, name: str, inputs: Inputs, key: tuple[bytes, ...], *further: np.ndarray
    ) -> tuple[Any, ...]:
        """Decode attributes; what an avatar's own changes add fades as its identity code moves to another person's.

        A beard that was trained for one face has no place on the face that another code gives.
        """

        def make() -> tuple[Any, ...]:
            loaded = target.loaded
            arguments = [self.engine.array(array) for array in (inputs.z_id, *further)]
            own = loaded.decoders[name](*arguments)
            if loaded.shared is None or not target.model.config.residuals:
                return own
            share = 1.0 - float(np.linalg.norm(inputs.z_id - target.avatar.z_id)) / loaded.reach
            if share == 1.0:
                return own
            plain = loaded.shared.decoders[name](*arguments)
            share = max(0.0, share)
            return tuple(a + share * (b - a) for a, b in zip(plain, own, strict=True))

        return self.cache.get((target.id, name, *key), make)


def at_rest(target: OpenAvatar, inputs: Inputs) -> Inputs:
    """The inputs of the person at rest."""
    still = target.still
    return dataclasses.replace(inputs, z_exp=still.z_exp, expression=still.expression, pose=still.pose, strength=still.strength)
