"""A head model of 160 vertices and views rendered from known colors, for the tests of model and training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES
from grmm_core.geometry.camera import Camera
from grmm_core.head import HeadModel
from grmm_core.model.grmm import GRMM
from grmm_core.model.inputs import ModelInputs
from grmm_core.training.config import TrainConfig, train_config
from grmm_core.training.trainer import Trainer
from grmm_core.training.views import View

ROWS, COLUMNS = 10, 16
RADIUS = 0.1
EXPRESSIONS = len(ARKIT_NAMES)
SHAPES = 4
TEETH = np.arange(70, 76)


def small_head(seed: int = 0) -> HeadModel:
    """A sphere cut open along a meridian, one UV island, some vertices called teeth."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(np.linspace(0.05, 0.95, ROWS), np.linspace(0.05, 0.95, COLUMNS), indexing="ij")
    longitude = (u - 0.5) * 2 * np.pi / 0.95
    latitude = (v - 0.5) * np.pi * 0.95
    vertices = RADIUS * np.stack(
        [np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)], -1
    ).reshape(-1, 3)
    index = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3).astype(np.int32)
    count = len(vertices)
    regressor = np.zeros((5, count), np.float32)
    regressor[np.arange(5), [0, 10, 40, 90, 120]] = 1.0
    weights = rng.random((count, 5)).astype(np.float32)
    return HeadModel(
        name="small_head", v_template=vertices.astype(np.float32), faces=faces,
        shape_dirs=rng.normal(0, 0.002, (count, 3, SHAPES)).astype(np.float32),
        expression_dirs=rng.normal(0, 0.002, (count, 3, EXPRESSIONS)).astype(np.float32), posedirs=None,
        J_regressor=regressor, parents=np.array([-1, 0, 1, 1, 1]), weights=weights / weights.sum(1, keepdims=True),
        uv=np.stack([u, v], -1).reshape(-1, 2).astype(np.float32), uv_faces=faces, uv_islands=np.zeros(len(faces), np.int32),
        regions={"upper_teeth": TEETH[:3], "lower_teeth": TEETH[3:]},
        shape_names=tuple(f"shape{i}" for i in range(SHAPES)), expression_names=ARKIT_NAMES,
        expression_pose=np.zeros((EXPRESSIONS, 5, 3), np.float32),
        arkit_to_expression=np.eye(len(ARKIT_NAMES), EXPRESSIONS, dtype=np.float32),
    )  # fmt: skip


class ColoredSpheres:
    """Views of two spheres, one reddish and one bluish, shaded by direction; sizes and poses known exactly."""

    def __init__(self, size: int = 48, count: int = 8) -> None:
        self.people = ("red", "blue")
        self.shapes = np.zeros((2, SHAPES), np.float32)
        self.training = np.arange(count)
        self.validation = np.arange(count, count + 4)
        self.subjects = np.arange(count + 4) % 2
        self.size = size

    def load(self, index: int) -> View:
        subject = index % 2
        camera = Camera.orbit(self.size, self.size, yaw=25.0 * (index - 4), pitch=10.0, distance=0.8, fov=20.0)
        rows, columns = np.mgrid[: self.size, : self.size] + 0.5
        rays = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], -1)
        rays = rays @ camera.world_to_camera[:3, :3]
        origin = camera.position
        a, b, c = (rays**2).sum(-1), rays @ origin, origin @ origin - RADIUS**2
        root = b * b - a * c
        hit = root > 0
        distance = (-b - np.sqrt(np.where(hit, root, 0.0))) / a
        normal = (origin + distance[..., None] * rays) / RADIUS
        color = np.array([[0.8, 0.4, 0.3], [0.3, 0.4, 0.8]])[subject] * (0.7 + 0.3 * normal[..., 1:2])
        image = np.where(hit[..., None], color * 255.0, 0.0).astype(np.uint8)
        depth = np.where(hit, distance, 0.0).astype(np.float32)
        aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
        aligned[index % 3] = 0.5
        expression = np.zeros(EXPRESSIONS, np.float32)
        pose = np.zeros((5, 3), np.float32)
        mask = np.where(hit, 255, 0).astype(np.uint8)
        return View(subject, f"view {index}", camera, image, mask, depth, aligned, expression, pose)


def randomise(model: GRMM, scale: float = 0.3) -> None:
    """Move every parameter, so that layers that start at zero take part."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in model.parameters():
            noise = torch.randn(parameter.shape, generator=generator, dtype=torch.float64).to(parameter.dtype)
            parameter.add_(noise * scale / max(1.0, parameter[0].numel() ** 0.5))


def inputs(model: GRMM, seed: int = 2) -> ModelInputs[torch.Tensor]:
    """Random coefficients, pose and codes of a model."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(model.dtype)

    shape, expression, pose = normal(SHAPES), 0.3 * normal(52), 0.1 * normal(5, 3)
    return ModelInputs(normal(model.z_id_size), normal(model.z_exp_size), shape, expression, pose)


def quiet_config(model: dict | None = None, **settings: object) -> TrainConfig:
    """A tiny run that writes nothing on its way."""
    quiet = {"checkpoint_every": 0, "preview_every": 0, "evaluate_every": 0}
    return train_config({"preset": "tiny", **(model or {})}, {"warmup_steps": 5, **quiet, **settings}, {"perceptual": 0.0})


def train_spheres(config: TrainConfig, head: HeadModel, folder: Path) -> Trainer:
    """Train both people briefly; checkpoint and weights `w.safetensors` are in the folder."""
    trainer = Trainer(config, head, ColoredSpheres(), folder)
    trainer.run()
    trainer.save()
    trainer.save_weights(folder / "w.safetensors", {})
    return trainer
