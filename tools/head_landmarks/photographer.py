"""Pictures of random people of the package as the landmark network sees them, and where the head model's landmarks are."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image
from torch.nn import functional

from grmm_core.controls.frame import Controls
from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.errors import NoFaceError
from grmm_core.geometry.camera import Camera
from grmm_core.hair import groom_names
from grmm_core.head import load_open_head
from grmm_core.light.shading import Response
from grmm_core.photo.faces import LANDMARK_COUNT, Region, find_faces, to_pixels
from grmm_core.pictures.color import linear_to_srgb
from grmm_core.pictures.images import quantize
from grmm_core.session import HairUse, Instance, RenderOptions, create_session

from ..photo_parser.bare_people import HELD_OUT, Light
from ..photo_parser.drawn import Generator
from ..photo_parser.samples import drawn_settings
from ..photo_parser.surroundings import background, blurred

FIRST = 10_000  # seeds of people from here on: those before are the ones that fits are measured on
PEOPLE, EACH = 12, 8  # people of a file, and pictures of each
SIDE, WIDTH = 320, 0.36  # pixels and metres of a picture
TURN, NOD = 58.0, 25.0  # degrees to the sides, up and down
LOST = 0.25  # eye distances that landmarks are off where another face, or none, was found
_SHAPES = sorted({name.removesuffix("Left").removesuffix("Right") for name in ALIGNED_NAMES})
_GREYS = np.array([0.3, 0.2, 0.15]), np.array([0.1, 0.07, 0.05])  # colors of skin and hair, which backgrounds have now and then


@dataclass(frozen=True)
class Shown:
    """One picture.

    Attributes:
        crop: What the network sees, [256, 256, 3] uint8.
        truth: The head model's landmarks there, pixels, [478, 2].
    """

    crop: np.ndarray
    truth: np.ndarray


class Photographer:
    """Draws people by chance; `held_out` ones are others than those that a network learns from."""

    def __init__(self, held_out: bool) -> None:
        self._session, self._head = create_session("local", threads=1), load_open_head()
        self._seeds = (HELD_OUT, 2 * HELD_OUT) if held_out else (FIRST, HELD_OUT)

    def pictures(self, g: Generator) -> Iterator[Shown]:
        """Some of a few people each."""
        for _ in range(PEOPLE):
            person, worn = self._session.sample(int(g.integers(*self._seeds))), _worn(g)
            for _ in range(EACH):
                shown = self._photographed(g, person.id, worn)
                if shown is not None:
                    yield shown
            self._session.release(person.id)

    def _photographed(self, g: Generator, person: int, worn: HairUse) -> Shown | None:
        """A person in an expression, from a side, in a light, before something."""
        pose = np.zeros((5, 3), np.float32)
        pose[1], pose[3:, :2] = g.normal(0, 0.06, 3), g.normal(0, 0.12, 2)
        controls, distance = Controls(aligned=_expression(g), pose=pose), g.uniform(0.5, 2.5)
        fov = 2 * np.degrees(np.arctan(WIDTH * g.uniform(0.475, 0.55) / distance))
        yaw, pitch = (float(np.clip(g.normal(0, sigma), -most, most)) for sigma, most in ((26, TURN), (10, NOD)))
        camera = Camera.orbit(SIDE, SIDE, yaw, pitch, distance, fov, (0.0, float(g.normal(-0.005, 0.01)), 0.0))
        light, response = Light.drawn(g, -camera.forward), Response(gloss=float(g.uniform(0, 1)))
        seen = Instance(person, controls, hair=worn, response=response, lighting=light.lighting)
        drawn = self._session.render([seen], camera, RenderOptions(passes=("rgb", "alpha")))
        picture = _developed(g, drawn["rgb"], drawn["alpha"])
        try:
            face = find_faces(picture, levels=1)[0]
        except NoFaceError:
            return None
        vertices = np.asarray(self._session.deform(person, controls).vertices, np.float64)
        truth = camera.project(self._head.landmark_positions(vertices, LANDMARK_COUNT).astype(np.float64))[1]
        found = face.landmarks[:, :2].astype(np.float64)
        if np.median(np.linalg.norm(found - truth, axis=1)) > LOST * face.eye_distance:
            return None
        region = Region.around(face.landmarks)
        crop = region.cut(to_pixels(picture))[0].permute(1, 2, 0).numpy()
        return Shown(quantize(crop), region.within(truth).astype(np.float32))


def _expression(g: Generator) -> np.ndarray:
    """Weights of the aligned expressions by chance, [60]: wide and narrow mouths, raised brows, and any others."""
    weights = np.zeros(len(ALIGNED_NAMES), np.float32)

    def put(shape: str, value: float, sides: tuple[str, ...] = ("Left", "Right", "")) -> None:
        for index, name in enumerate(ALIGNED_NAMES):
            if name in [shape + side for side in sides]:
                weights[index] = max(weights[index], value)

    def perhaps(share: float, least: float, most: float, *shapes: str) -> None:
        if g.random() < share:
            for shape in shapes:
                put(shape, g.uniform(least, most))

    if g.random() < 0.1:
        return weights
    for _ in range(int(g.integers(0, 6))):
        shape = _SHAPES[int(g.integers(len(_SHAPES)))]
        put(shape, g.uniform(0.1, 1.0), ("Left", "Right", "") if g.random() < 0.8 else (str(g.choice(["Left", "Right"])), ""))
    if g.random() < 0.5:
        put("jawOpen", g.beta(1.3, 2.5))
    if g.random() < 0.45:  # a smile of shapes that are wider together than the widest alone
        smile = g.uniform(0.2, 1.0)
        put("mouthSmile", smile)
        perhaps(0.5, 0.0, smile, "cheekSquint")
        perhaps(0.5, 0.0, 0.6 * smile, "eyeSquint")
        perhaps(0.5, 0.0, 1.0, "mouthDimple")
        perhaps(0.4, 0.0, 1.0, "mouthStretch")
        perhaps(0.4, 0.1, 1.0, "mouthUpperUp")
    elif g.random() < 0.35:
        perhaps(1.0, 0.2, 1.0, *g.permutation(["mouthPucker", "mouthFunnel"])[: g.integers(1, 3)])
    perhaps(0.15, 0.1, 1.0, "eyeBlink")
    perhaps(0.15, 0.1, 0.8, "mouthUpperUp")
    perhaps(0.2, 0.1, 0.8, "mouthLowerDown")
    perhaps(0.2, 0.2, 1.0, "browInnerUp", "browOuterUp")
    perhaps(0.15, 0.2, 1.0, "browDown")
    return weights


def _worn(g: Generator) -> HairUse:
    """Hair, brows and beard by chance."""

    def one(part: str) -> str:
        names = groom_names(part)
        return names[int(g.integers(len(names)))]

    scalp = "none" if g.random() < 0.12 else f"groom:{one('scalp')}"
    beard = one("beard") if g.random() < 0.3 else "none"
    return HairUse(scalp, drawn_settings(g), brows=one("brows"), beard=beard, lashes="natural")


def _developed(g: Generator, rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """A person before something, exposed, blurred, tinted, with a sensor's noise and a file's blocks, [S, S, 3] uint8."""
    behind = torch.from_numpy(background(g, *_GREYS).astype(np.float32)).permute(2, 0, 1)[None]
    ground = functional.interpolate(behind, size=(SIDE, SIDE), mode="bilinear")[0].permute(1, 2, 0).numpy()
    if g.random() < 0.6:
        ground = blurred(ground, g.uniform(1.0, 8.0))
    person = rgb[alpha[..., 0] > 0.99].max(-1)
    bright = float(np.quantile(person, 0.85)) if len(person) else 0.8
    exposed = np.clip(rgb, 0, None) / max(bright, 1e-3) * g.uniform(0.55, 1.05)
    image = np.clip(exposed + linear_to_srgb(np.clip(ground, 0, 1)) * (1 - alpha), 0, 1) ** np.exp(g.normal(0, 0.2))
    if g.random() < 0.35:
        image = blurred(image, g.uniform(0.4, 2.0))
    image = image * np.exp(g.normal(0, 0.06, 3)) + g.normal(0, 0.03 * g.random() ** 2, image.shape)
    picture = quantize(np.clip(image, 0, 1))
    if g.random() < 0.4:
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "JPEG", quality=int(g.integers(30, 90)))
        picture = np.asarray(Image.open(buffer))
    return picture
