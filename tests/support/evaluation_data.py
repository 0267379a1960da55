"""A capture whose pictures a model of random weights has drawn itself: a perfect score is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grmm_core.controls.frame import Controls, resolve
from grmm_core.data.dataset import write_manifest, write_shot, write_subject
from grmm_core.data.types import Manifest, Picture, Shot, View
from grmm_core.geometry.camera import Camera

SIZE = 48
HELD_OUT = "stranger"
SPLITS = ("train", "camera", "expression")


def write_own_pictures(folder: Path, scene) -> Path:
    """Two trained people with a view of each split, and a held-out one with three."""
    write_manifest(folder, Manifest("open_head", ["person 0", "person 1", HELD_OUT], {}, [HELD_OUT]))
    for number, name in enumerate(("person 0", "person 1")):
        write_person(folder, scene, name, scene.info.z_id[number], scene.info.shapes[number], SPLITS)
    code = scene.info.z_id.mean(0) + 0.7 * (scene.info.z_id[2] - scene.info.z_id[3])
    write_person(folder, scene, HELD_OUT, code, scene.info.shapes.mean(0), ("person",) * 3)
    return folder


def write_person(folder: Path, scene, name: str, z_id: np.ndarray, shape: np.ndarray, splits: tuple[str, ...]) -> None:
    write_subject(folder, name, shape, {})
    person = scene.made(name, z_id, shape)
    for number, split in enumerate(splits):
        weights = {} if number == 0 else {"jawOpen": 0.6, "mouthSmileLeft": 0.3 * number}
        controls = resolve(Controls().set_named(weights), scene.head)
        camera = Camera.orbit(SIZE, SIZE, yaw=40.0 * number - 10.0, pitch=5.0, distance=1.1, fov=23.0)
        image, depth = f"{number:04d}_00.png", f"{number:04d}_00_z.png"
        views = (View(f"c{number:02d}", camera, image, depth, split),)
        shot = Shot(name, number, "mix", controls.aligned, controls.expression, controls.pose, views, folder / "shots" / name)
        drawn = scene.draw(person, shot, camera)
        alpha = drawn.alpha.numpy().clip(0, 1)
        straight = drawn.image.numpy() / np.maximum(alpha[..., None], 1e-3)
        write_shot(folder, shot, [Picture(straight.clip(0, 1), alpha, drawn.depth.numpy() * (alpha > 0.5))])
