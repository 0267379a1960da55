"""The avatars that a session has open: from a source to codes and the model that draws them. Used by `local`."""

from __future__ import annotations

import dataclasses
import itertools
import logging
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..avatar import Avatar, load_avatar
from ..avatar.library import DEFAULT_NAME, library_path
from ..controls.frame import Controls
from ..errors import SessionError
from ..geometry.libraries import to_numpy
from ..hair.packaged import HEAD
from ..model.people import default_avatar, sampled_avatar
from .carrying import can_carry, in_its_colors, without_changes
from .engines import Engine
from .evaluator import FRONT, Evaluator, OpenAvatar
from .random_hair import random_hair
from .sources import SourceKey, source_key
from .values import AvatarInfo
from .wardrobe import READY

_NOBODY = 0  # no avatar has this number

_log = logging.getLogger(__name__)


class OpenAvatars:
    """Avatars by number.

    People drawn at random can be drawn again from their seed, and their hair takes megabytes: only as many as the wardrobe
    keeps hair ready for are held, or a session in which somebody looks for a face would grow without end.

    Args:
        engine: Has the weights.
        evaluator: Checks an avatar's inputs; forgets what it keeps of avatars that are released.
    """

    def __init__(self, engine: Engine, evaluator: Evaluator) -> None:
        self._engine, self._evaluator = engine, evaluator
        self._infos: dict[int, AvatarInfo] = {}
        self._keys: dict[int, SourceKey] = {}
        self._held: dict[int, OpenAvatar] = {}
        self._numbers = itertools.count(1)

    def __len__(self) -> int:
        return len(self._keys)

    def next_number(self) -> int:
        """A number that nothing else in the session has."""
        return next(self._numbers)

    def open(self, key: SourceKey) -> AvatarInfo:
        """Return the avatar of a source, opened if it is not. Raises as `Session.open`."""
        known = next((number for number, other in self._keys.items() if other == key), None)
        if known is not None:
            return self._infos[known]
        target = self._make(self.next_number(), key)
        # Reject an avatar that does not fit before it gets an id.
        self._evaluator.inputs(target, Controls())
        self._keys[target.id], self._infos[target.id] = key, _info(target)
        self._hold(target)
        return self._infos[target.id]

    def release(self, number: int) -> None:
        """Forget an avatar; harmless where there is none."""
        for known in (self._held, self._infos, self._keys):
            known.pop(number, None)
        self._evaluator.cache.drop(number)

    def clear(self) -> None:
        """Forget all."""
        for known in (self._held, self._infos, self._keys):
            known.clear()

    def target(self, number: int) -> OpenAvatar:
        """Return an avatar with its model. Raises `SessionError`."""
        if number not in self._keys:
            raise SessionError(f"There is no avatar {number} in this session; open it first.")
        target = self._held.get(number) or self._make(number, self._keys[number])
        self._hold(target)
        return target

    def _hold(self, target: OpenAvatar) -> None:
        self._held.pop(target.id, None)
        self._held[target.id] = target
        drawn = [number for number, known in self._held.items() if known.source.kind == "sample"]
        for number in drawn[:-READY]:
            del self._held[number]

    def _make(self, number: int, key: SourceKey) -> OpenAvatar:
        path = self._file_of(key)
        if path is not None:
            avatar = self._carried_over(load_avatar(path), path)
            return OpenAvatar(number, avatar, self._engine.store.for_avatar(avatar, path), key)
        loaded = self._engine.store.default()
        size = loaded.model.z_exp_size
        if key.kind == "sample":
            made = sampled_avatar(loaded.info, size, int(key.name), loaded.model.head_model)
        else:
            made = default_avatar(loaded.info, size)
        if key.kind == "sample" and loaded.model.config.hairless and loaded.info.head_name == HEAD:
            bare = OpenAvatar(number, made, loaded, key)
            colors, _ = self._evaluator.appearance(bare, bare.still, FRONT)
            skin = float(np.median(to_numpy(colors).mean(1)))
            made = dataclasses.replace(made, hair=random_hair(int(key.name), skin, made.shape))
        return OpenAvatar(number, made, loaded, key)

    def _carried_over(self, avatar: Avatar, path: Path) -> Avatar:
        """The avatar itself, or where its weights are not installed what can be carried over to the default ones."""
        store = self._engine.store
        if store.knows(avatar) or not can_carry(avatar, loaded := store.default()):
            return avatar
        plain = without_changes(avatar, loaded)
        target = OpenAvatar(_NOBODY, plain, loaded, source_key(path))
        try:
            colors, _ = self._evaluator.appearance(target, target.still, FRONT)
        finally:
            self._evaluator.cache.drop(_NOBODY)
        _log.warning(
            "%s was made on the weights %r, which are not installed: its shape and colors were carried over to %r; "
            "save it, or make it anew from its photos.", path, avatar.weights.name, loaded.info.name,
        )  # fmt: skip
        return in_its_colors(plain, loaded, to_numpy(colors))

    def _file_of(self, key: SourceKey) -> Path | None:
        """The `.grmm` file behind a source, or None where it is made from the weights alone."""
        if key.kind == "file":
            return Path(key.name)
        if key.kind == "library":
            return library_path(key.name)
        # weights of the user's own have a default person of their own
        return library_path(DEFAULT_NAME) if key.kind == "default" and self._engine.store.embedded else None


def _info(target: OpenAvatar) -> AvatarInfo:
    avatar, loaded = target.avatar, target.loaded
    model: Any = loaded.model
    return AvatarInfo(
        id=target.id,
        name=avatar.name,
        source=target.source.label,
        head_name=loaded.info.head_name,
        head_sha256=loaded.info.head_sha256,
        weights_name=loaded.info.name,
        weights_sha256=loaded.info.sha256,
        vertex_count=len(model.head_model.v_template),
        gaussian_count=model.gaussian_count,
        feature_count=model.config.features,
        z_id_size=model.z_id_size,
        z_exp_size=model.z_exp_size,
        shape=avatar.shape,
        z_id=avatar.z_id,
        aligned_code_norms=loaded.space.code_norms,
        provenance=MappingProxyType(dataclasses.asdict(avatar.provenance)),
        thumbnail=avatar.thumbnail,
        hair=None if avatar.hair is None else avatar.hair.settings,
        hair_parts=MappingProxyType({} if avatar.hair is None else dict(avatar.hair.parts)),
        antialiased=model.config.antialias,
    )
