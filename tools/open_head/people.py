"""Random people and the shape space.

A person is a set of target weights: the macro targets (age, gender, ethnicity, muscle, weight), weighted by products as
MakeHuman does, and local targets of head, face, ears and neck, drawn around zero. Everything is linear in the weights, so the
principal components are computed among the targets without ever making the people's vertices.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass

import numpy as np

from .parts import InnerParts
from .source import Source
from .topology import DECIMETRE, Topology

PEOPLE = 4000
COMPONENTS = 300
SEED = 20250101
MACRO_NAMES = ("age", "female", "african", "asian", "caucasian", "muscle", "weight")
MACRO_UNITS = "years; the others 0..1, the three ethnicities sum to 1"
AGES = (18.0, 80.0)  # years
BUST_IMPORTANCE = 0.35  # of the neck and shoulders in the ordering of components
# Standard deviation of local target weights by folder (1 is the target's own extreme).
SPREAD = {
    "head": 0.1, "forehead": 0.16, "eyebrows": 0.2, "eyes": 0.2, "nose": 0.2, "mouth": 0.2, "cheek": 0.22, "chin": 0.18,
    "ears": 0.22, "neck": 0.1, "asym": 0.09,
}  # fmt: skip
ASYMMETRY = 0.04  # extra spread of each side of a two-sided target
OPPOSITES = (
    ("incr", "decr"), ("up", "down"), ("in", "out"), ("forward", "backward"), ("concave", "convex"), ("uncompress", "compress"),
)  # fmt: skip
# Translations of head and neck only move them on the shoulders, and "asymm" targets are the trunk's.
SKIPPED = re.compile(r"head-trans|head-angle|neck-trans|asymm-")


@dataclass
class ShapeSpace:
    """Mean person, directions in metres per unit-variance coefficient, and what the macros say about the coefficients.

    Attributes:
        mean: [V, 3].
        directions: [V, 3, S].
        macro_mean: Mean of `MACRO_NAMES`, [M].
        macro_std: Their standard deviations, [M].
        macro_to_shape: Expected coefficients per unit of (macro - macro_mean), [M, S].
        residual_std: Standard deviation of each coefficient once the macros are known, [S].
        explained: Share of the variance that the components keep.
    """

    mean: np.ndarray
    directions: np.ndarray
    macro_mean: np.ndarray
    macro_std: np.ndarray
    macro_to_shape: np.ndarray
    residual_std: np.ndarray
    explained: float


def build_shape_space(source: Source, topology: Topology, parts: InnerParts, importance: np.ndarray) -> ShapeSpace:
    """Draw people and compute the shape space.

    Args:
        source: The wheel's data.
        topology: The open head's mesh.
        parts: How eyes, teeth and tongue follow the skin.
        importance: Weight of each vertex in the ordering of components, [V].
    """
    generator = np.random.default_rng(SEED)
    names, offsets = _load_targets(source, topology, parts)
    anchored = _anchor(source, topology, offsets)  # [K, V, 3] metres
    macros = _draw_macros(generator)
    weights = np.concatenate([_macro_weights(names, macros), _local_weights(names, generator)], 1)
    mirrored = weights[:, _mirror_columns(names)]
    both = np.concatenate([weights, mirrored])
    mean_weights = both.mean(0)
    base = _anchor_base(source, topology, parts)
    mean = base + np.einsum("k,kvi->vi", mean_weights, anchored)

    centred = both - mean_weights
    covariance = centred.T @ centred / len(both)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # covariance = root root^T
    scale = np.repeat(np.sqrt(importance), 3)
    flat = anchored.reshape(len(names), -1)
    # float32 is ample here and halves the time
    left, singular, right = np.linalg.svd((root.T @ flat * scale).astype(np.float32), full_matrices=False)
    directions = (singular[:COMPONENTS, None] * right[:COMPONENTS] / scale).astype(np.float64)
    # coefficients of a person: whitened target weights seen through the kept components
    inverse_root = vectors * np.where(values > 1e-10, 1.0 / np.sqrt(np.maximum(values, 1e-10)), 0.0)
    coefficients = (weights - mean_weights) @ inverse_root @ left[:, :COMPONENTS]
    # sign convention: a component widens or lengthens the face when it grows (its largest offset is positive)
    sign = np.sign(directions[np.arange(COMPONENTS), np.abs(directions).argmax(1)])
    directions *= sign[:, None]
    coefficients *= sign

    table = np.stack([macros[name] for name in MACRO_NAMES], 1)
    # the ethnicities sum to 1: the minimum-norm solution shares their effect evenly
    matrix = np.linalg.lstsq(table - table.mean(0), coefficients, rcond=1e-6)[0]
    residual = coefficients - (table - table.mean(0)) @ matrix
    return ShapeSpace(
        mean=mean,
        directions=directions.reshape(COMPONENTS, -1, 3).transpose(1, 2, 0),
        macro_mean=table.mean(0),
        macro_std=table.std(0),
        macro_to_shape=matrix,
        residual_std=residual.std(0),
        explained=float((singular[:COMPONENTS] ** 2).sum() / (singular**2).sum()),
    )


def _load_targets(source: Source, topology: Topology, parts: InnerParts) -> tuple[list[str], np.ndarray]:
    """Return the names (macro targets first) and offsets in metres of every target that is used, [K, V, 3]."""
    paths = []
    for path in source.target_names("macrodetails"):
        if "baby" not in path:
            paths.append(path)
    for folder in SPREAD:
        paths += [path for path in source.target_names(folder) if not SKIPPED.search(path)]
    offsets = [parts.follow(DECIMETRE * (topology.matrix @ source.target(path))) for path in paths]
    names = [path.rsplit("/", 2)[-2] + "/" + path.rsplit("/", 1)[-1].removesuffix(".target.gz") for path in paths]
    return names, np.array(offsets)


def ear_and_eye_anchor(topology: Topology, positions: np.ndarray, ears: np.ndarray) -> np.ndarray:
    """Return the point that becomes the origin: x midway between the eyes, y and z midway between the ears, [..., 3]."""
    eyes = [positions[..., topology.parts[f"{side}_eyeball"], :].mean(-2) for side in ("left", "right")]
    point = 0.5 * (positions[..., ears[0], :] + positions[..., ears[1], :])
    point[..., 0] = 0.5 * (eyes[0] + eyes[1])[..., 0]
    return point


def ear_canals(source: Source, topology: Topology) -> np.ndarray:
    """Return the left and right vertex nearest to the ear canal: the deepest point of each ear's bowl, [2]."""
    positions = topology.matrix @ source.vertices
    ears = topology.matrix @ source.mask("ears")
    result = []
    for side in (1.0, -1.0):
        candidates = np.flatnonzero((ears > 0.5) & (positions[:, 0] * side > 0))
        height = positions[candidates, 1]
        depth = positions[candidates, 2]
        middle = (np.abs(height - height.mean()) < 0.15) & (np.abs(depth - depth.mean() - 0.02) < 0.08)
        inner = candidates[middle]
        result.append(inner[np.argmin(np.abs(positions[inner, 0]))])
    return np.array(result)


def _anchor(source: Source, topology: Topology, offsets: np.ndarray) -> np.ndarray:
    ears = ear_canals(source, topology)
    return offsets - ear_and_eye_anchor(topology, offsets, ears)[:, None]


def _anchor_base(source: Source, topology: Topology, parts: InnerParts) -> np.ndarray:
    return parts.base - ear_and_eye_anchor(topology, parts.base, ear_canals(source, topology))


def _draw_macros(generator: np.random.Generator) -> dict[str, np.ndarray]:
    races = generator.dirichlet((0.6, 0.6, 0.6), PEOPLE)
    return {
        "age": generator.uniform(*AGES, PEOPLE),
        "female": generator.beta(0.35, 0.35, PEOPLE),
        "african": races[:, 0], "asian": races[:, 1], "caucasian": races[:, 2],
        "muscle": np.clip(generator.normal(0.5, 0.18, PEOPLE), 0, 1),
        "weight": np.clip(generator.normal(0.5, 0.2, PEOPLE), 0, 1),
    }  # fmt: skip


def _macro_weights(names: list[str], macros: dict[str, np.ndarray]) -> np.ndarray:
    """Product weights of the macro targets, [P, K_macro]. Ages in MakeHuman: child 10, young 25, old 90 years."""
    age = macros["age"]
    grid = np.array([10.0, 25.0, 90.0])
    factors = {name: np.interp(age, grid, row) for name, row in zip(("child", "young", "old"), np.eye(3), strict=True)}
    factors |= {"female": macros["female"], "male": 1 - macros["female"]}
    factors |= {name: macros[name] for name in ("african", "asian", "caucasian")}
    for kind in ("muscle", "weight"):
        for prefix, row in zip(("min", "average", "max"), np.eye(3), strict=True):
            factors[prefix + kind] = np.interp(macros[kind], [0, 0.5, 1], row)
    factors["universal"] = np.ones(PEOPLE)
    columns = []
    for name in itertools.takewhile(lambda n: n.startswith("macrodetails/"), names):
        column = np.ones(PEOPLE)
        for word in name.removeprefix("macrodetails/").split("-"):
            column = column * factors[word]
        columns.append(column)
    return np.stack(columns, 1)


def _local_weights(names: list[str], generator: np.random.Generator) -> np.ndarray:
    """Weights of the local targets, [P, K_local]: opposite targets share one signed value, sides share most of it."""
    local = [name for name in names if not name.startswith("macrodetails/")]
    index = {name: i for i, name in enumerate(local)}
    result = np.zeros((PEOPLE, len(local)))
    drawn: dict[str, np.ndarray] = {}
    for name in local:
        if result[:, index[name]].any():
            continue
        folder = name.split("/")[0]
        shared_name = re.sub(r"/[lr]-", "/", name)
        if shared_name not in drawn:
            drawn[shared_name] = generator.normal(0.0, SPREAD[folder], PEOPLE)
        value = drawn[shared_name]
        if shared_name != name:
            value = value + generator.normal(0.0, ASYMMETRY, PEOPLE)
        value = np.clip(value, -0.9, 0.9)
        opposite = _opposite(name, index)
        result[:, index[name]] = np.maximum(value, 0.0)
        if opposite:
            result[:, index[opposite]] = np.maximum(-value, 0.0)
        elif folder == "asym" or name.startswith("head/"):
            result[:, index[name]] *= 0.7
    return result


def _opposite(name: str, index: dict[str, int]) -> str | None:
    for pair in OPPOSITES:
        for one, other in (pair, pair[::-1]):
            if name.endswith("-" + one) or f"-{one}-" in name:
                inner = name.replace(f"-{one}-", f"-{other}-")
                candidate = name.removesuffix(one) + other if name.endswith("-" + one) else inner
                if candidate in index:
                    return candidate
    return None


def _mirror_columns(names: list[str]) -> np.ndarray:
    index = {name: i for i, name in enumerate(names)}
    columns = []
    for name in names:
        if name.startswith("asym/"):
            other = re.sub(r"-([lr])$", lambda m: "-r" if m.group(1) == "l" else "-l", name)
        else:
            other = re.sub(r"/([lr])-", lambda m: "/r-" if m.group(1) == "l" else "/l-", name)
        columns.append(index.get(other, index[name]))
    return np.array(columns)
