"""Pictures of a model's codes: random people, interpolations, one expression on several people. Used by the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from ..geometry.camera import Camera
from ..jobs.progress import Share, nobody
from ..model.people import sampled_avatar
from ..model.portrait import portrait
from ..pictures.images import write_png
from .disentanglement import smoothness
from .report import sheet
from .scene import DrawnPerson, Scene

RANDOM_PEOPLE = 16
STEPS = 9
SHOWN_PEOPLE = 5
BACKGROUND = 0.5
SIZE = 256
YAWS = (-20.0, 10.0, 25.0, -5.0)
SHOWN_EXPRESSIONS: tuple[dict[str, float], ...] = (
    {}, {"laugh": 1.0}, {"surprise": 1.0}, {"mouthPucker": 1.0}, {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
)  # fmt: skip
STRIP_ENDS = ({"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0}, {"visemeOO": 1.0})


def write_pictures(scene: Scene, folder: Path, size: int = SIZE, report: Share = nobody) -> dict[str, Any]:
    """Write all sheets of codes into a folder.

    Args:
        scene: Model; knows at least two people.
        folder: Exists.
        size: Side of a picture in pixels.
        report: Hears how much is done.

    Returns:
        JSON values: file names, and the smoothness of both strips.

    Raises:
        ConfigError: The model knows fewer than two people.
        FileAccessError: The folder is not writable.
    """
    write_png(folder / "random_people.png", sheet(random_people(scene, size)))
    report(0.4, "random people")
    identity = identity_strip(scene, size)
    expression = expression_strip(scene, size)
    write_png(folder / "interpolations.png", sheet([[_array(p) for p in strip] for strip in (identity, expression)]))
    report(0.7, "interpolations")
    write_png(folder / "same_expressions.png", sheet(same_expressions(scene, size)))
    report(1.0, "expressions on several people")
    return {
        "pictures": ["random_people.png", "interpolations.png", "same_expressions.png"],
        "interpolation of z_id": smoothness(identity), "interpolation of z_exp": smoothness(expression),
    }  # fmt: skip


def random_people(scene: Scene, size: int, count: int = RANDOM_PEOPLE) -> list[list[np.ndarray]]:
    """People drawn from the model with seeds 0, 1, 2 ..., none chosen, in rows of four."""
    pictures = []
    for seed in range(count):
        drawn = sampled_avatar(scene.info, scene.model.z_exp_size, seed, scene.model.head_model)
        person = scene.from_avatar(drawn)
        pictures.append(_array(posed(scene, person, {}, size, YAWS[seed % len(YAWS)])))
    return [pictures[i : i + 4] for i in range(0, count, 4)]


def identity_strip(scene: Scene, size: int, steps: int = STEPS) -> list[Tensor]:
    """From one training person to another, code and shape together."""
    first, last = 0, len(scene.info.people) - 1
    result = []
    for t in np.linspace(0.0, 1.0, steps):
        z_id, shape = ((1 - t) * table[first] + t * table[last] for table in (scene.info.z_id, scene.info.shapes))
        result.append(posed(scene, scene.made("", z_id, shape), {}, size))
    return result


def expression_strip(scene: Scene, size: int, steps: int = STEPS) -> list[Tensor]:
    """From one expression to another on the default person."""
    person = scene.made("", scene.info.default_z_id, scene.info.default_shape)
    start, end = STRIP_ENDS
    result = []
    for t in np.linspace(0.0, 1.0, steps):
        weights = {name: (1 - t) * value for name, value in start.items()} | {name: t * value for name, value in end.items()}
        result.append(posed(scene, person, weights, size))
    return result


def same_expressions(scene: Scene, size: int) -> list[list[np.ndarray]]:
    """Rows of training people, columns of expressions."""
    count = len(scene.info.people)
    rows = []
    for index in np.unique(np.linspace(0, count - 1, min(count, SHOWN_PEOPLE)).astype(int)):
        person = scene.made("", scene.info.z_id[index], scene.info.shapes[index])
        rows.append([_array(posed(scene, person, controls, size)) for controls in SHOWN_EXPRESSIONS])
    return rows


def posed(scene: Scene, person: DrawnPerson, controls: Mapping[str, float], size: int, yaw: float = 15.0) -> Tensor:
    """A person with named controls, from the front, [H, W, 3]."""
    camera = Camera.orbit(size, size, yaw=yaw, pitch=5.0, distance=1.2, fov=19.0)
    return portrait(person.model, person, controls, camera, (BACKGROUND,) * 3, scene.backend).image.clamp(0.0, 1.0)


def transfer_sheet(scene: Scene, people: Sequence[DrawnPerson], size: int = SIZE) -> list[list[np.ndarray]]:
    """Fitted people in rows, driven with expressions that their photo does not show."""
    return [[_array(posed(scene, p, controls, size)) for controls in SHOWN_EXPRESSIONS] for p in people]


def _array(picture: Tensor) -> np.ndarray:
    array: np.ndarray = picture.cpu().numpy()
    return array
