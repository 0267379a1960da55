"""What single components of the residual codes do to the face, in words: "Chin forward", "Hair darker".

The codes are learned, so nobody has named their components. This moves each by one standard deviation about the default
person at rest, sees which part of the mesh moves and which way, and which part's color changes, and sorts by what is seen
most. It evaluates the mesh decoder (eq. 5-11) and the linear color maps with numpy, from the arrays of the weights file: some
tenths of a second, once for each file, without a runtime. Components that move the mesh by less than can be seen change the
Gaussians only, and have no name. Components of a head model's shape are named in the same way, by the head model alone.
Used by panels and operators; imports neither bpy nor torch.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...grmm_core.controls.table import Z_EXP, Z_ID
from ...grmm_core.errors import GrmmError
from ...grmm_core.files.packing import unpack
from ...grmm_core.head import HeadModel
from ...grmm_core.model.config import BASIS_COLOR
from ...grmm_core.model.weights_file import WeightsFile, read_weights, resolve_weights
from .. import session_host

_log = logging.getLogger(__name__)

_SLOPE = 0.2  # of the decoders' leaky rectifiers
_DECODER = "mesh_decoder."
_COLOR_WEIGHTS, _COLOR_MAPS = "decoders.basis_weights.weight", f"decoders.basis.{BASIS_COLOR}"
_CODES = "aligned_codes"
_JOINTS = 6  # axis-angle vectors of neck and jaw, at rest
# Parts of the face by the nearest of the 68 landmarks, in the iBUG order.
_LANDMARK_PARTS = (
    ("Jaw", (*range(2, 6), *range(11, 15))), ("Chin", range(6, 11)), ("Temples", (0, 1, 15, 16)), ("Brows", range(17, 27)),
    ("Nose", range(27, 36)), ("Eyes", range(36, 48)), ("Lips", range(48, 68)),
)  # fmt: skip
_CHEEKS = ((2, 31), (14, 35))  # landmarks on both sides of each cheek: jaw line and nostril
_BROW, _FOREHEAD_RISE = range(17, 27), 0.03  # metres above the brows
_REGION_PARTS = (("Ears", "ears"), ("Neck", "neck"), ("Scalp", "scalp"), ("Tongue", "tongue"))
_DIRECTIONS = (("left", "right"), ("up", "down"), ("forward", "back"))
_TOGETHER = 0.6  # of the mean motion that one direction must have to be named
_ONE_SIDED = 2.0  # times that one side must move more than the other to be named
_MIDLINE = 0.005  # metres: nearer the middle a vertex belongs to no side
_SEEN_MOTION, _SEEN_COLOR = 0.1, 0.01  # the least that can be seen: millimetres; display sRGB 0..1
_COLOR_PARTS = (("Skin", ("face", "neck", "ears")), ("Hair", ("scalp",)), ("Eyes", ("left_eyeball", "right_eyeball")))
_TINTS = (("redder", "less red"), ("greener", "less green"), ("bluer", "less blue"))
_TINTED = 0.5  # of the whole change that must be common to the three channels to be called lighter or darker


@dataclass(frozen=True)
class Component:
    """What a component of a residual code does.

    Attributes:
        index: Place in the code.
        label: What a positive value does, in words; empty where that is unknown.
        effect: What one standard deviation does, in multiples of what can just be seen.
        spread: Standard deviation of the component in the trained codes.
    """

    index: int
    label: str
    effect: float
    spread: float


def components(name: str, size: int) -> tuple[Component, ...]:
    """Return the components of a residual code, the one whose effect is seen most first.

    Args:
        name: `Z_ID` or `Z_EXP`.
        size: Length of the avatar's code.

    Returns:
        [size] components; without names or order, and of spread 1, where the weights do not tell.
    """
    path = resolve_weights(session_host.settings().weights or None)
    try:
        found = _tables(path, path.stat().st_mtime_ns)[name]
    except (OSError, GrmmError, KeyError, ValueError) as error:  # foreign weights: sliders have numbers only
        _log.info("components of %s have no names: %s", path, error)
        found = ()
    return found if len(found) == size else tuple(Component(k, "", 0.0, 1.0) for k in range(size))


@functools.lru_cache(maxsize=2)
def _tables(path: Path, stamp: int) -> dict[str, tuple[Component, ...]]:
    """Both codes' components of a weights file. Raises `KeyError` and `ValueError` for networks of another structure."""
    file = read_weights(path)
    head, codes, person = file.head, file.arrays[_CODES], file.info.default_z_id
    parts = face_parts(head)
    decoder = _MeshDecoder(file.arrays, head.vertex_count)
    rest = np.zeros(codes.shape[1], np.float32)
    spreads = {Z_ID: _spread(file.info.z_id, person.size), Z_EXP: _spread(codes, rest.size)}
    colors = _color_changes(file, spreads[Z_ID])
    found = {}
    for name, spread in spreads.items():
        steps = np.diag(spread)  # [K, K]
        if name == Z_ID:
            moved = decoder(person + steps, rest[None]) - decoder(person - steps, rest[None])
        else:
            moved = decoder(person[None], rest + steps) - decoder(person[None], rest - steps)
        made = []
        for k in range(len(spread)):
            label, motion = describe(moved[k] / 2, head, parts)
            effect = motion / _SEEN_MOTION
            if name == Z_ID and colors:
                tint, change = _describe_color({part: each[k] for part, each in colors.items()})
                if change / _SEEN_COLOR > effect:
                    bald = file.info.config.hairless  # what is seen there is skin
                    label, effect = tint.replace("Hair", "Scalp") if bald else tint, change / _SEEN_COLOR
            if effect < 1.0:
                label = ""  # it moves the mesh by less than can be seen, and no mean color
            made.append(Component(k, label, effect, float(spread[k])))
        found[name] = tuple(sorted(made, key=lambda item: (-item.effect if item.effect >= 1.0 else 0.0, -item.spread)))
    return found


@functools.lru_cache(maxsize=2)
def shape_labels(head: HeadModel, count: int) -> tuple[str, ...]:
    """Return in words what the leading shape components of a head model do to the head, beside moving all of the face."""
    parts = {
        name: vertices for name, vertices in face_parts(head).items() if name != "Neck"
    }  # which moves most, and is seen least
    motions = 1000.0 * head.shape_dirs[:, :, :count]
    motions = motions - motions[np.asarray(head.regions["face"])].mean(0)
    return tuple(describe(motions[:, :, k], head, parts)[0] for k in range(motions.shape[2]))


def face_parts(head: HeadModel) -> dict[str, np.ndarray]:
    """Name of a part of the face to its vertices: face vertices by the nearest landmark, and whole regions beside it."""
    marks = head.landmark_positions(head.v_template, 68)
    points = [marks[list(numbers)] for _, numbers in _LANDMARK_PARTS]
    points.append(np.array([marks[list(pair)].mean(0) for pair in _CHEEKS]))
    points.append(marks[list(_BROW)] + [0.0, _FOREHEAD_RISE, 0.0])
    names = [*(name for name, _ in _LANDMARK_PARTS), "Cheeks", "Forehead"]
    face = np.asarray(head.regions["face"])
    distance = np.stack([np.linalg.norm(head.v_template[face, None] - near, axis=2).min(1) for near in points])  # [P, F]
    nearest = distance.argmin(0)
    parts = {name: face[nearest == number] for number, name in enumerate(names)}
    parts |= {name: np.asarray(head.regions[region]) for name, region in _REGION_PARTS if region in head.regions}
    return {name: vertices for name, vertices in parts.items() if len(vertices)}


def describe(motion: np.ndarray, head: HeadModel, parts: dict[str, np.ndarray]) -> tuple[str, float]:
    """Say in words what moves most, and how far.

    Args:
        motion: Displacement of each vertex, millimetres, head axes, [V, 3].
        head: Whose vertices these are.
        parts: Of `face_parts`.

    Returns:
        Label, and root mean square motion of the part, millimetres.
    """
    far = {name: float(np.sqrt((motion[vertices] ** 2).sum(1).mean())) for name, vertices in parts.items()}
    name = max(far, key=far.__getitem__)
    vertices = parts[name]
    x = head.v_template[vertices, 0]
    sides = {side: vertices[x * sign > _MIDLINE] for side, sign in (("Left", 1.0), ("Right", -1.0))}
    side = ""
    if all(len(found) for found in sides.values()):
        amount = {key: float((motion[found] ** 2).sum(1).mean()) for key, found in sides.items()}
        side = next((key for key in sides if amount[key] > _ONE_SIDED**2 * (sum(amount.values()) - amount[key])), "")
    moved = motion[sides[side] if side else vertices]
    where = _direction(moved, head.v_template[sides[side] if side else vertices], far[name])
    return f"{f'{side} {name.lower()}' if side else name} {where}", far[name]


def _direction(motion: np.ndarray, places: np.ndarray, size: float) -> str:
    """Word for where a part goes: a direction that it has in common, else how it changes, from motion and places [N, 3]."""
    mean = motion.mean(0)
    axis = int(np.abs(mean).argmax())
    if abs(mean[axis]) > _TOGETHER * size:
        return _DIRECTIONS[axis][int(mean[axis] < 0)]
    centred = places - places.mean(0)
    growth = (centred * motion).sum(0) / np.maximum((centred**2).sum(0), 1e-12) * centred.std(0)  # millimetres along each axis
    axis = int(np.abs(growth).argmax())
    return (("wider", "narrower"), ("taller", "flatter"), ("deeper", "shallower"))[axis][int(growth[axis] < 0)]


def _color_changes(file: WeightsFile, spread: np.ndarray) -> dict[str, np.ndarray]:
    """Mean change of each part's color for one standard deviation of each component of z_id, [K, 3]; empty without maps."""
    stored = file.packed.get(_COLOR_MAPS)
    maps = file.arrays.get(_COLOR_MAPS) if stored is None else unpack(*stored)
    if maps is None:
        return {}
    weights = file.arrays[_COLOR_WEIGHTS] * spread  # [M, K]
    texels = maps.reshape(len(weights), -1, 3)  # [M, N, 3]
    corner = file.head.faces[file.layout.face, 0]  # [N]
    found = {}
    for name, regions in _COLOR_PARTS:
        inside = np.isin(corner, np.concatenate([file.head.regions[region] for region in regions]))
        if inside.any():
            found[name] = weights.T @ texels[:, inside].mean(1)
    return found


def _describe_color(changes: dict[str, np.ndarray]) -> tuple[str, float]:
    """Say which part's color changes most and how, and by how much, from the mean changes [3]."""
    name = max(changes, key=lambda part: float(np.linalg.norm(changes[part])))
    change = changes[name]
    size = float(np.linalg.norm(change))
    common = float(change.mean())
    if abs(common) * np.sqrt(3.0) > _TINTED * size:
        return f"{name} {'lighter' if common > 0 else 'darker'}", size
    channel = int(np.abs(change - common).argmax())
    return f"{name} {_TINTS[channel][int(change[channel] < common)]}", size


def _spread(codes: np.ndarray, size: int) -> np.ndarray:
    """Standard deviation of each component over trained codes [N, K]; 1 where there are too few to tell."""
    if codes.ndim != 2 or codes.shape[1] != size or len(codes) < 2:
        return np.ones(size, np.float32)
    spread = codes.std(0)
    return np.where(spread > 0, spread, 1.0).astype(np.float32)


class _MeshDecoder:
    """The mesh decoder at rest (no joint rotation, no expression) with numpy; a readable twin is `model.mesh_decoder`."""

    def __init__(self, arrays: Mapping[str, np.ndarray], vertex_count: int) -> None:
        self._arrays = {name.removeprefix(_DECODER): array for name, array in arrays.items() if name.startswith(_DECODER)}
        self._count = vertex_count
        rest = self._layers("film", np.zeros((1, self._arrays["film.0.weight"].shape[1]), np.float32))
        self._gamma, self._beta = np.split(rest, 2, axis=1)

    def __call__(self, z_id: np.ndarray, z_exp: np.ndarray) -> np.ndarray:
        """Displacements in millimetres, [B, V, 3], of codes [B or 1, Z] and [B or 1, Y]."""
        joints = np.zeros((len(z_id), _JOINTS), np.float32)
        base = _rectify(self._layers("shared", np.concatenate([z_id, joints], 1)))  # f_base, [B, H]
        rows = max(len(z_id), len(z_exp))
        features = np.concatenate(
            [np.broadcast_to(base, (rows, base.shape[1])), np.broadcast_to(z_exp, (rows, z_exp.shape[1]))], 1
        )  # eq. 7
        features = features * (1.0 + self._gamma) + self._beta  # eq. 9
        moved = self._layers("identity", base) + self._layers("expression", features)
        return moved.reshape(rows, self._count, 3)

    def _layers(self, name: str, values: np.ndarray) -> np.ndarray:
        """Two linear layers with a leaky rectifier in between."""
        arrays = self._arrays
        hidden = _rectify(values @ arrays[f"{name}.0.weight"].T + arrays[f"{name}.0.bias"])
        return hidden @ arrays[f"{name}.2.weight"].T + arrays[f"{name}.2.bias"]


def _rectify(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0, values, _SLOPE * values)
