"""One picture for the parser: a bare path-traced head of a capture, with strands, clothes, props, light and a background.

`Maker.make` returns what the network sees and the labels. Needs numba and torch.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace

import numpy as np
import torch
from PIL import Image
from torch.nn import functional

from grmm_core.data.dataset import CaptureDataset
from grmm_core.data.layers import PARTS
from grmm_core.data.types import Shot, View
from grmm_core.fitting.track import frame_of
from grmm_core.geometry.zbuffer import triangle_depth
from grmm_core.hair import groom_names, library_groom
from grmm_core.hair.drawing import Hiding, StrandGaussians, level_shares, strand_gaussians
from grmm_core.hair.ribbons import Eye
from grmm_core.hair.roots import GROUPS
from grmm_core.hair.settings import HairSettings
from grmm_core.hair.strands import StrandBlock, blocks_of
from grmm_core.head import HeadModel
from grmm_core.photo.parser import LABELS, MESH_PARTS, SIZE, mesh_channels, part_map
from grmm_core.photo.person import person_mask
from grmm_core.pictures.color import linear_to_srgb, srgb_to_linear
from grmm_core.splat.api import rasterize_arrays
from grmm_core.splat.types import GaussianArrays

from .drawn import Drawn, Generator, noise, smooth, unit
from .props import Hat, dress, glasses, occluder
from .surroundings import background, blurred, lit

IGNORED = 255  # label of pixels beyond the photo's edge
CLOSE = "face"  # name of the camera that cuts hair off
FRONT = 0.25  # cosine between the face's direction and the camera's from which a photo would be tracked
NAMES = list(MESH_PARTS)


@dataclass(frozen=True)
class Sample:
    """A picture for the parser: display sRGB, mask and validity uint8 [5, S, S]; `mesh_channels` float16; labels uint8."""

    picture: np.ndarray
    mesh: np.ndarray
    labels: np.ndarray


class Maker:
    """Makes samples out of a capture."""

    def __init__(self, folder: str, head: HeadModel, held_out: bool) -> None:
        self.data, self.head = CaptureDataset(folder), head
        out = set(self.data.manifest.held_out_people)
        names = [name for name in self.data.subjects if (name in out) == held_out]
        self.people = names
        self.views: list[tuple[Shot, View, bool]] = []
        for shot in self.data.shots:
            for view in shot.views:
                towards = view.camera.view_direction(np.zeros(3))
                if shot.subject in names and towards[2] > FRONT:
                    bare = view.bare if view.bare is not None else view
                    often = 1 if view.name == CLOSE else 4
                    self.views += [(shot, bare, False)] * often
                    if not view.only_bare:
                        self.views += [(shot, view, True)] * often
        self._grooms: list[tuple[StrandBlock, ...]] = []

    def refresh_grooms(self, g: Generator, count: int) -> None:
        """Take other grooms; making one ready takes a while, so that each serves for many pictures."""
        self._grooms = []
        names = list(groom_names())
        for _ in range(count):
            scalp = library_groom(names[int(g.integers(len(names)))])
            own = self.data.groom(self.people[int(g.integers(len(self.people)))])
            if own is None or g.random() < 0.5:
                own = own or scalp
                parts = blocks_of(own.level(0.35), self.head.v_template, self.head.faces)
            else:
                face = own.select(own.groups > 0)
                parts = (
                    *(b for b in blocks_of(scalp.level(0.5), self.head.v_template, self.head.faces) if b.group == 0),
                    *blocks_of(face, self.head.v_template, self.head.faces),
                )
            self._grooms.append(parts)

    def make(self, g: Generator, kind: int | None = None) -> Sample:
        """Draw a picture; `kind` chooses the view instead of chance."""
        shot, view, haired = self.views[int(g.integers(len(self.views))) if kind is None else kind % len(self.views)]
        drawn, vertices, parts, limits = self._base(shot, view, g)
        skin, found = self._label(drawn, vertices, parts, haired)
        blocks = self._grooms[int(g.integers(len(self._grooms)))] if self._grooms else ()
        settings = _settings(g)
        hair = np.array([0.02, 0.012, 0.006]) if haired else _hair_color(settings)
        bald = not haired and g.random() < 0.07
        if not haired:
            _paint_scalp(drawn, found, skin, None if bald or g.random() < 0.05 else hair, g.uniform(0.35, 0.95))
        hat = Hat(g) if g.random() < (0.1 if haired else 0.2) else None
        hiding = dress(drawn, self.head, vertices, g, skin, hair)
        if not haired:
            self._hair(drawn, vertices, blocks, settings, hat, bald, hiding)
        if g.random() < 0.28:
            glasses(drawn, self.head, vertices, g)
        if hat is not None:
            hat.draw(drawn, self.head, vertices, g, skin, hair)
        mouth = drawn.camera.project(vertices[self.head.regions["lips"]].mean(0)[None])[1][0]
        if g.random() < 0.28:
            occluder(drawn, g, skin, hair, mouth)
        cover = drawn.cover.copy()
        image, backlit = lit(drawn, g)
        ground = background(g, skin, hair) * (g.uniform(1.2, 3.0) if backlit else np.exp(g.normal(0, 0.3)))
        if g.random() < 0.1:
            ground = self._passer_by(ground, g)
        if g.random() < 0.5:
            ground = blurred(ground, g.uniform(0.5, 5.0))
        image = image * cover[..., None] + np.clip(ground, 0, 1.3) * (1 - cover[..., None])
        return self._sample(shot, image, drawn, cover, limits, g)

    def _base(self, shot: Shot, view: View, g: Generator) -> tuple[Drawn, np.ndarray, np.ndarray, np.ndarray]:
        """Cut the frame of a working picture out of a view, a little off and turned."""
        picture = self.data.picture(shot, view)
        layers = [picture.rgb, picture.mask[..., None], self.data.layer(shot, view, "normal")]
        layers.append(self.data.layer(shot, view, "parts").transpose(1, 2, 0))
        layers[0] = srgb_to_linear(layers[0]) * picture.mask[..., None]
        stack = torch.from_numpy(np.concatenate(layers, -1).astype(np.float32)).permute(2, 0, 1)[None]
        camera = view.camera
        border = np.concatenate([picture.mask[0], picture.mask[:, 0], picture.mask[:, -1]]).max() > 0.1
        angle = 0.0 if border else g.normal(0, 0.16)  # the edges of photos are upright
        c, s = np.cos(angle), np.sin(angle)
        turn = np.eye(4)
        turn[:2, :2] = [[c, -s], [s, c]]
        camera = replace(camera, world_to_camera=turn @ camera.world_to_camera)
        left, top, side = frame_of(camera)
        scale = np.exp(g.normal(0, 0.05))
        left, top = np.array([left, top]) + side * (1 - scale) / 2 + g.normal(0, 0.02, 2) * side
        side *= scale
        size = SIZE
        factor = size / side
        fine = 2 if side < 1.1 * view.camera.width else 1
        at = (np.arange(size * fine) + 0.5) / fine / factor
        u, v = np.meshgrid(left + at - camera.cx, top + at - camera.cy)
        u, v = c * u + s * v + camera.cx, c * v - s * u + camera.cy
        places = np.stack([u / view.camera.width, v / view.camera.height], -1) * 2 - 1
        sampled = functional.grid_sample(stack, torch.from_numpy(places[None]).float(), align_corners=False)
        taken = functional.avg_pool2d(sampled, fine)[0].permute(1, 2, 0).numpy()
        inside = (np.abs(places) < 1).all(-1).reshape(size, fine, size, fine).min((1, 3))
        camera = replace(
            camera,
            fx=camera.fx * factor,
            fy=camera.fy * factor,
            cx=(camera.cx - left) * factor,
            cy=(camera.cy - top) * factor,
            width=size,
            height=size,
        )
        vertices = self.head.vertices(self.data.shape(shot.subject), shot.expression, shot.pose)
        if shot.displacement is not None:
            vertices = vertices + shot.displacement
        cover = taken[..., 3]
        color = taken[..., :3] / np.maximum(cover[..., None], 1e-4)
        depth = triangle_depth(vertices[self.head.faces], camera)
        drawn = Drawn(camera, color, np.zeros((size, size), np.uint8), cover, unit(taken[..., 4:7]), depth)
        return drawn, vertices, taken[..., 7:], inside if border else np.ones_like(inside)

    def _label(self, drawn: Drawn, vertices: np.ndarray, parts: np.ndarray, haired: bool) -> tuple[np.ndarray, np.ndarray]:
        """Label the head itself; returns the color of its skin [3] and the parts of the mesh [S, S]."""
        found, _ = part_map(self.head, vertices, drawn.camera)
        table = np.array([*(LABELS.index(name if name != "scalp" and name != "brows" else "skin") for name in NAMES), 0])
        drawn.labels = np.where(drawn.cover > 0.5, table[np.where(found < 0, NAMES.index("skin"), found)], 0).astype(np.uint8)
        if haired:
            for name in ("hair", "brows", "beard"):
                drawn.labels[parts[..., PARTS.index(name)] > 0.4] = LABELS.index(name)
        face = (found == NAMES.index("skin")) & (drawn.cover > 0.9) & (drawn.labels == LABELS.index("skin"))
        return np.median(drawn.color[face], axis=0) if face.any() else np.array([0.3, 0.17, 0.1]), found

    def _hair(
        self,
        drawn: Drawn,
        vertices: np.ndarray,
        blocks: tuple[StrandBlock, ...],
        settings: HairSettings,
        hat: Hat | None,
        bald: bool,
        hiding: np.ndarray,
    ) -> None:
        """Draw strands over the picture and label them."""
        blocks = tuple(b for b in blocks if not (bald and b.group == 0))
        if not blocks:
            return
        camera, eye = drawn.camera, Eye.of(drawn.camera)
        depth = hiding.astype(np.float32)
        shield = Hiding(depth, 1.0, -camera.cx, -camera.cy)
        shares = level_shares(blocks, eye.pixels_per_metre())
        made, groups = [], []
        for block, share in zip(blocks, shares, strict=True):
            origin, axes = (part.astype(np.float32) for part in block.frames.at(vertices))
            points = np.matmul(block.styled(settings), axes) + origin[:, None]
            own = (
                settings
                if block.group == 0
                else settings.changed(length=1.0, grey=settings.grey * 0.6, melanin=min(1.0, settings.melanin + 0.1))
            )
            made.append(strand_gaussians(block, points, axes, own, share, eye, shield))
            groups.append(np.full(len(made[-1].means), block.group))
        joined = StrandGaussians(*(np.concatenate(arrays) for arrays in zip(*made, strict=True)))
        opacities = joined.opacities
        group = np.concatenate(groups)
        if hat is not None:
            opacities = np.where(hat.hides(joined.means) & (group == 0), 0.0, opacities)
        use = opacities > 0
        colors = srgb_to_linear(np.clip(joined.colors, 0, 1))
        features = np.eye(len(GROUPS))[group].astype(np.float32)
        picture = rasterize_arrays(
            GaussianArrays(*(a[use] for a in (joined.means, joined.quats, joined.scales, opacities, colors, features))), camera
        )
        cover = picture.alpha
        middle = camera.project(np.array([[0.0, 0.03, 0.0]]))[1][0]
        rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
        radius = 0.13 * eye.pixels_per_metre()
        x, y = (columns - middle[0]) / radius, (rows - middle[1]) / radius
        out = np.stack([x, y, -np.sqrt(np.clip(1 - x * x - y * y, 0.05, 1))], -1) @ camera.world_to_camera[:3, :3]
        drawn.lay(cover, picture.rgb / np.maximum(cover[..., None], 1e-4), None, unit(out))
        most = picture.features.argmax(-1)
        for number, name in enumerate(("hair", "brows", "beard", "eyes")):
            there = (most == number) & (cover > (0.4 if number != 1 else 0.3))
            if name != "eyes":
                drawn.labels[there] = LABELS.index(name)

    def _passer_by(self, ground: np.ndarray, g: Generator) -> np.ndarray:
        """Somebody else in the background."""
        shot, view, _ = self.views[int(g.integers(len(self.views)))]
        picture = self.data.picture(shot, view)
        pixels = np.concatenate([srgb_to_linear(picture.rgb) * picture.mask[..., None], picture.mask[..., None]], -1)
        planes = torch.from_numpy(pixels.astype(np.float32)).permute(2, 0, 1)[None]
        small = functional.interpolate(planes, (SIZE, SIZE), mode="area")[0].permute(1, 2, 0).numpy()
        shift = (int(g.integers(-20, 20)), int(g.choice([-1, 1])) * int(g.integers(35, 75)))
        small = np.roll(small, shift, (0, 1))
        return ground * (1 - small[..., 3:]) + small[..., :3] * np.exp(g.normal(0, 0.5))

    def _sample(
        self, shot: Shot, image: np.ndarray, drawn: Drawn, cover: np.ndarray, inside: np.ndarray, g: Generator
    ) -> Sample:
        """Camera, the photo's edges, the mask that would be found, the mesh that would be tracked."""
        display = linear_to_srgb(np.clip(image, 0, 1)).astype(np.float32)
        if g.random() < 0.3:
            display = blurred(display, g.uniform(0.3, 1.3))
        if g.random() < 0.25:
            buffer = io.BytesIO()
            Image.fromarray((display.clip(0, 1) * 255).astype(np.uint8)).save(buffer, "JPEG", quality=int(g.integers(15, 80)))
            display = np.asarray(Image.open(buffer), np.float32) / 255
        valid = inside.astype(np.float32)
        for side in range(4):
            if g.random() < 0.35:
                width = int(g.integers(1, 32 if side != 1 else 22))
                valid = np.rot90(valid, side).copy()
                valid[:width] = 0
                valid = np.rot90(valid, -side)
        display = np.where(valid[..., None] > 0, display, 0.5)
        if g.random() < 0.55:
            large = functional.interpolate(
                torch.from_numpy(display.astype(np.float32)).permute(2, 0, 1)[None], scale_factor=2.0, mode="bicubic"
            )
            mask = person_mask(large[0].permute(1, 2, 0).numpy().clip(0, 1))
            mask = functional.avg_pool2d(torch.from_numpy(mask)[None, None], 2)[0, 0].numpy()
        else:
            mask = blurred(cover[..., None], g.uniform(0.3, 2.5))[..., 0]
            rough = 0.35 * noise(g, SIZE, 5, 6) * (g.random() < 0.5)
            mask = smooth(g.uniform(0.0, 0.45), g.uniform(0.5, 1.0), mask + rough)
        shape = self.data.shape(shot.subject)
        tracked = np.zeros(self.head.shape_count)
        tracked[: len(shape)] = shape * g.uniform(0.4, 1.0) + g.normal(0, 0.25, len(shape)) * (np.arange(len(shape)) < 40)
        pose = shot.pose + g.normal(0, 0.02, shot.pose.shape) * [[0], [1], [1], [1], [1]]
        vertices = self.head.vertices(tracked, shot.expression * g.uniform(0.7, 1.1), pose)
        camera = drawn.camera
        near = np.eye(4)
        near[:3, 3] = g.normal(0, 0.002, 3)
        yaw, pitch = g.normal(0, 0.045, 2)
        near[:3, :3] = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]) @ np.array(
            [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
        )
        camera = camera.transformed(near)
        scale = np.exp(g.normal(0, 0.015))
        camera = replace(camera, fx=camera.fx * scale, fy=camera.fy * scale)
        mesh = mesh_channels(self.head, vertices, camera)
        labels = np.where(valid > 0, drawn.labels, IGNORED).astype(np.uint8)
        picture = np.concatenate([display, (mask * valid)[..., None], valid[..., None]], -1)
        return Sample((picture.clip(0, 1) * 255).round().astype(np.uint8).transpose(2, 0, 1), mesh.astype(np.float16), labels)


def _settings(g: Generator) -> HairSettings:
    dyed = g.random() < 0.06
    return HairSettings(
        length=float(g.choice([g.uniform(0.15, 0.45), np.clip(np.exp(g.normal(0.0, 0.35)), 0.2, 1.6)], p=[0.35, 0.65])),
        density=float(g.choice([1.0, g.uniform(0.4, 1.0)])),
        thickness=g.uniform(0.8, 1.6), curl=g.uniform(-0.6, 0.8), frizz=g.random() ** 2, melanin=g.beta(1.6, 1.1),
        redness=g.random() ** 3, grey=float(g.choice([0.0, g.random(), 1.0], p=[0.55, 0.25, 0.2])), variation=g.random(),
        tips=g.uniform(-0.3, 0.5), dye=0.9 if dyed else 0.0, dye_red=g.random(), dye_green=g.random(), dye_blue=g.random(),
        sheen=g.uniform(0.0, 2.2),
    )  # fmt: skip


def _hair_color(settings: HairSettings) -> np.ndarray:
    from grmm_core.hair.pigment import albedos

    color: np.ndarray = albedos(settings, np.zeros(1), np.full((1, 2), 0.5))[0, 0]
    return color


def _paint_scalp(drawn: Drawn, found: np.ndarray, skin: np.ndarray, hair: np.ndarray | None, share: float) -> None:
    """Take the shaved look off the scalp, and tint it by a share of the hair's color where hair stands."""
    scalp = blurred((found == NAMES.index("scalp"))[..., None].astype(np.float32), 1.5)
    shade = drawn.color.mean(-1, keepdims=True) / max(
        float(np.median(drawn.color[found == NAMES.index("scalp")])) if (found == NAMES.index("scalp")).any() else 1.0, 1e-3
    )
    tone = skin if hair is None else skin + share * (hair - skin)
    drawn.color = drawn.color * (1 - scalp) + scalp * np.clip(shade, 0.3, 2.0) * tone
    if hair is not None:
        drawn.labels[(found == NAMES.index("scalp")) & (drawn.cover > 0.5)] = LABELS.index("hair")
