"""People for the parser's pictures: random avatars of the package, bare, in the rig's light and in another one.

The engine's light throws the shadows of nose, brows and chin, which normals alone do not know: in the shade of a lamp at the
side skin has the colors of hair.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grmm_core.controls.frame import Controls, resolve
from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import triangle_depth
from grmm_core.head import HeadModel
from grmm_core.light.lamps import Lighting, Sun
from grmm_core.light.shading import Response
from grmm_core.light.surroundings import Surroundings
from grmm_core.pictures.color import srgb_to_linear
from grmm_core.session import HairUse, Instance, RenderOptions, create_session

from .drawn import Generator, unit

PIXELS = 256
HELD_OUT = 1_000_000  # seeds from here on are of people to measure on
BARE = HairUse("none", brows="none", beard="none", lashes="none")
TURN = 65.0  # degrees to either side, up to which a photo would be tracked


@dataclass(frozen=True)
class Light:
    """Lamps and even light around a person.

    Attributes:
        towards: Unit vectors to the lamps, head space, [L, 3].
        colors: Irradiance of each in its direction, linear RGB, [L, 3].
        hard: Whether a lamp is one that normals feel beyond its edge, [L].
        ambient: Irradiance from everywhere, linear RGB, [3].
        tilt: Where more of that comes from, with its share as length, [3].
        side: The only lamp is beside the face, as a window is.
        backlit: The lamps are behind the person.
    """

    towards: np.ndarray
    colors: np.ndarray
    hard: np.ndarray
    ambient: np.ndarray
    tilt: np.ndarray
    side: bool
    backlit: bool

    @staticmethod
    def drawn(g: Generator, to_eye: np.ndarray) -> Light:
        """By chance; `to_eye` points from the head to the camera, [3]."""
        side, backlit = g.random() < 0.35, g.random() < 0.12
        ambient = g.uniform(0.05, 0.6) * np.exp(g.normal(0, 0.12, 3))
        tilt = unit(g.normal((0, 0.8, 0), 1, 3)) * 0.6 * g.random()
        if side:
            turn, lift = np.radians(g.choice([-1, 1]) * g.uniform(45, 115)), np.radians(g.uniform(-10, 50))
            c, s = np.cos(turn), np.sin(turn)
            level = unit(to_eye * [1.0, 0.0, 1.0])
            beside = np.array([c * level[0] + s * level[2], 0.0, c * level[2] - s * level[0]])
            towards = (np.cos(lift) * beside + [0.0, np.sin(lift), 0.0])[None]
            colors = np.exp(g.normal(0, 0.15, (1, 3))) * g.uniform(0.8, 1.6)
            return Light(towards, colors, g.random(1) < 0.3, ambient * g.uniform(0.1, 0.6), tilt, True, False)
        if g.random() < 0.2:  # from above, as the sun at noon: the chin throws its shadow
            towards = unit(to_eye * g.uniform(0.1, 0.7) + g.normal(0, 0.25, 3) + [0, 1, 0])[None]
            return Light(towards, np.full((1, 3), g.uniform(0.6, 1.4)), g.random(1) < 0.4, ambient * 0.7, tilt, False, False)
        if g.random() < 0.12:  # a stage: two colors from two sides
            left = unit(np.cross(to_eye, [0.0, 1.0, 0.0])) * g.choice([-1, 1])
            towards = unit(np.stack([left, -left]) + to_eye * g.uniform(-0.2, 1.0, (2, 1)) + g.normal(0, 0.5, (2, 3)))
            colors = np.exp(g.normal(0, 0.8, (2, 3))) * g.uniform(0.4, 1.2, (2, 1))
            return Light(towards, colors, g.random(2) < 0.3, ambient * g.uniform(0.2, 1.0), tilt, False, False)
        count = int(g.integers(1, 4))
        towards = unit(g.normal(0, 1, (count, 3)) + (to_eye * -1.3 if backlit else to_eye * 0.9) + [0, 0.5, 0])
        colors = np.exp(g.normal(0, 0.15, (count, 3))) * g.uniform(0.2, 1.2, (count, 1))
        return Light(towards, colors, g.random(count) < 0.4, ambient, tilt, False, backlit)

    @property
    def lighting(self) -> Lighting:
        """As a session takes it."""
        suns = (
            Sun(color=tuple(color), direction=tuple(way), angle=0.3 if hard else 0.8)
            for color, way, hard in zip(self.colors, self.towards, self.hard, strict=True)
        )
        return Lighting(tuple(suns), Surroundings.even(tuple(self.ambient / np.pi)))


@dataclass(frozen=True)
class Posed:
    """A bare person before a camera.

    Attributes:
        camera: In head space, square.
        color: In the rig's light, straight linear RGB, [S, S, 3].
        lit: In `light`, likewise.
        cover: [S, S].
        normals: Head space, [S, S, 3].
        light: Of `lit`.
        vertices: [V, 3].
        shape, expression, pose: Of the head model.
    """

    camera: Camera
    color: np.ndarray
    lit: np.ndarray
    cover: np.ndarray
    normals: np.ndarray
    light: Light
    vertices: np.ndarray
    shape: np.ndarray
    expression: np.ndarray
    pose: np.ndarray


class People:
    """Draws them; `held_out` ones are others than those that a network learns from."""

    def __init__(self, head: HeadModel, held_out: bool) -> None:
        self._head, self._first, self._seeds = head, HELD_OUT * held_out, list[int]()
        self._session = create_session("local", threads=1)

    def exchange(self, g: Generator, count: int) -> None:
        """Take other people: the first picture of a person takes seconds more, so that each serves for many."""
        for gone in self._seeds:
            self._session.release(self._session.sample(gone).id)
        self._seeds = [self._first + int(seed) for seed in g.integers(0, HELD_OUT, count)]

    def posed(self, g: Generator) -> Posed:
        """One of them, by chance, from a side from which a photo would be tracked."""
        person = self._session.sample(self._seeds[int(g.integers(len(self._seeds)))])
        weights = np.zeros(len(ALIGNED_NAMES), np.float32)
        if g.random() < 0.7:
            weights[g.integers(len(weights), size=2)] = g.uniform(0.2, 1.0, 2)
        pose = np.zeros((5, 3), np.float32)
        pose[1], pose[3:, :2] = g.normal(0, 0.08, 3), g.normal(0, 0.1, 2)
        controls = Controls(aligned=weights, pose=pose)
        near = g.random() < 0.12  # the face alone, so that the photo's edge cuts hair off
        distance = g.uniform(0.5, 0.9) if near else g.uniform(0.8, 2.5)
        fov = 2 * np.degrees(np.arctan((0.15 if near else 0.28) / distance))
        yaw = float(np.clip(g.normal(0, 28), -TURN, TURN))
        target = (0.0, float(g.normal(0.0, 0.01)), 0.0)
        camera = Camera.orbit(PIXELS, PIXELS, yaw, float(g.normal(0, 9)), distance, fov, target)
        light = Light.drawn(g, -camera.forward)

        def drawn(lighting: Lighting | None) -> dict[str, np.ndarray]:
            response = None if lighting is None else Response(gloss=float(g.uniform(0.0, 1.0)))
            worn = Instance(person.id, controls, hair=BARE, response=response)
            passes = ("rgb",) if lighting else ("rgb", "alpha", "normal")
            return self._session.render([worn], camera, RenderOptions(passes=passes, lighting=lighting))

        usual, other = drawn(None), drawn(light.lighting)
        cover = usual["alpha"][..., 0]
        color, lit = (
            srgb_to_linear(np.clip(each["rgb"] / np.maximum(cover, 1e-3)[..., None], 0, 2)) for each in (usual, other)
        )
        vertices = np.asarray(self._session.deform(person.id, controls).vertices, np.float64)
        taken = resolve(controls, self._head)
        return Posed(
            camera, color, lit, cover, usual["normal"], light, vertices, np.asarray(person.shape), taken.expression, taken.pose
        )

    def depth(self, posed: Posed, camera: Camera) -> np.ndarray:
        """Of the mesh in a camera, metres, [H, W]."""
        return triangle_depth(posed.vertices[self._head.faces], camera)
