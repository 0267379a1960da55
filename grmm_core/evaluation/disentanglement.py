"""Whether identity and expression are separate in a model, and whether its codes are smooth.

Expressions are compared as displacements: where the 68 landmarks, and the Gaussians, of a person go from the neutral face, in
head space with neck at rest. The difference of two people's displacements is stated in millimetres and relative to the size of
the displacement itself. Used by the command line; `strips` makes the pictures.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..controls.frame import Controls
from ..controls.names import MIXTURE_NAMES
from ..errors import ConfigError
from ..jobs.progress import Share, nobody
from ..model.inputs import Person
from .scene import Scene

PEOPLE = 10
EXPRESSIONS: tuple[str, ...] = (
    *MIXTURE_NAMES, "jawOpen", "mouthPucker", "mouthFunnel", "cheekPuff", "mouthSmileLeft", "browInnerUp", "noseSneerLeft",
    "eyeBlinkLeft",
)  # fmt: skip
MM = 1e3
_PERSON_SEED = 5


@dataclass(frozen=True)
class Posed:
    """One person with one expression.

    Attributes:
        landmarks: [68, 3] metres.
        gaussians: Centres, [N, 3] metres.
        learned: Learned mesh displacement at the landmarks, [68, 3] metres.
    """

    landmarks: np.ndarray
    gaussians: np.ndarray
    learned: np.ndarray


def separation(scene: Scene, report: Share = nobody) -> dict[str, Any]:
    """Measure how much the same expression differs between people, and how much z_id alone changes an expression.

    Args:
        scene: Model.
        report: Hears how much is done.

    Returns:
        JSON values: ``same z_exp, other people`` (z_id and shape change) and ``z_id changed alone`` (the shape stays), each
        for the landmarks, the learned part of their motion, and the Gaussians; and of each expression.

    Raises:
        ConfigError: The model knows fewer than two people, or its head has no landmarks.
    """
    people = _people(scene)
    mean_shape = scene.info.shapes.mean(0)
    rows: dict[str, dict[str, Any]] = {}
    total = 2 * len(people)
    tables: dict[str, list[dict[str, Posed]]] = {"people": [], "codes": []}
    for number, person in enumerate(people):
        for place, (kind, shape) in enumerate((("people", scene.info.shapes[person]), ("codes", mean_shape))):
            tables[kind].append({name: posed(scene, scene.info.z_id[person], shape, name) for name in ("", *EXPRESSIONS)})
            report((2 * number + place + 1) / total, "people and expressions")
    result: dict[str, Any] = {"people": len(people), "expressions": len(EXPRESSIONS)}
    for kind, label in (("people", "same z_exp, other people"), ("codes", "z_id changed alone")):
        for part in ("landmarks", "learned", "gaussians"):
            for name in EXPRESSIONS:
                moved = [getattr(table[name], part) - getattr(table[""], part) for table in tables[kind]]
                rows.setdefault(f"{label}: {part}", {})[name] = spread(moved)
            figures = rows[f"{label}: {part}"].values()
            difference = float(np.mean([f["difference_mm"] for f in figures]))
            size = float(np.mean([f["size_mm"] for f in figures]))
            result[f"{label}: {part}"] = {
                "difference_mm": difference, "size_mm": size, "percent": 100.0 * difference / max(size, 1e-9),
            }  # fmt: skip
    result["by expression"] = rows
    return result


def spread(moved: Sequence[np.ndarray]) -> dict[str, float]:
    """Mean distance between the displacements of all pairs, and the mean length of the displacements.

    Args:
        moved: One [K, 3] a person, metres.
    """
    array = np.stack(moved) * MM  # [P, K, 3]
    first, second = np.triu_indices(len(array), 1)
    difference = np.linalg.norm(array[first] - array[second], axis=-1)
    return {"difference_mm": float(difference.mean()), "size_mm": float(np.linalg.norm(array, axis=-1).mean())}


@torch.no_grad()
def posed(scene: Scene, z_id: np.ndarray, shape: np.ndarray, name: str) -> Posed:
    """Pose a person of code z_id [Z] and shape [S] with an aligned expression at full strength; "" is neutral."""
    model = scene.model
    controls = Controls().set_named({name: 1.0} if name else {})
    inputs = model.tensors(model.input_space().inputs(Person(z_id, shape), controls))
    posed_mesh = model.mesh(inputs)
    geometry = model.geometry(posed_mesh.vertices, model.offsets(inputs.z_id, inputs.z_exp))
    mesh, learned = (part.cpu().numpy() for part in posed_mesh)
    return Posed(scene.head.landmark_positions(mesh), geometry.means.cpu().numpy(), scene.head.landmark_positions(learned))


def smoothness(pictures: Sequence[Tensor]) -> dict[str, float]:
    """How evenly a strip of pictures [H, W, 3] changes.

    Returns:
        ``largest step``: the largest change between neighbours relative to the mean one (1 is perfectly even, a jump in a strip
        of n pictures is n - 1); ``detour``: the sum of the changes relative to the change from first to last (1 is the
        straight way; pictures that come and go make it longer).
    """
    steps = [float((b - a).abs().mean()) for a, b in itertools.pairwise(pictures)]
    whole = float((pictures[-1] - pictures[0]).abs().mean())
    mean = float(np.mean(steps))
    return {"largest step": max(steps) / max(mean, 1e-12), "detour": sum(steps) / max(whole, 1e-12)}


def _people(scene: Scene) -> list[int]:
    count = len(scene.info.people)
    if count < 2:
        raise ConfigError(f"The weights {scene.info.name!r} know fewer than two people to compare; choose others.")
    if scene.head.landmarks68 is None:
        raise ConfigError(f"The head model {scene.head.name} has no landmarks to measure expressions with; use another one.")
    return sorted(np.random.default_rng(_PERSON_SEED).permutation(count)[:PEOPLE].tolist())
