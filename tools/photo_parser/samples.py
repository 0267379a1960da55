"""One picture for the parser: a bare head, with strands, clothes, props, light and a background.

`Maker.make` returns what the network sees and the labels. Needs numba and torch.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace

import numpy as np
import torch
from PIL import Image
from torch.nn import functional

from grmm_core.fitting.track import frame_of
from grmm_core.hair import groom_names, library_groom
from grmm_core.hair.drawing import Hiding, StrandGaussians, level_shares, strand_gaussians
from grmm_core.hair.ribbons import Eye
from grmm_core.hair.roots import BEARD, BROWS, GROUPS, LASHES, SCALP
from grmm_core.hair.settings import HairSettings
from grmm_core.hair.strands import StrandBlock, blocks_of
from grmm_core.head import HeadModel
from grmm_core.photo.parser import LABELS, MESH_PARTS, SIZE, mesh_channels, part_map
from grmm_core.photo.person import person_mask
from grmm_core.pictures.color import linear_to_srgb, srgb_to_linear
from grmm_core.splat.api import rasterize_arrays
from grmm_core.splat.types import GaussianArrays

from .bare_people import People, Posed
from .drawn import Drawn, Generator, noise, smooth, unit, unprojected
from .long_hair import long_hair
from .props import Hat, dress, glasses, leaves, make_up, occluder, shade_throat
from .surroundings import background, blurred, lit

IGNORED = 255  # label of pixels beyond the photo's edge
DETAIL = {SCALP: 0.5, BROWS: 1.0, BEARD: 0.7, LASHES: 1.0}  # share of the strands of grooms that are drawn
BEARDED = 0.4  # of the people
LONG = 0.45  # of the grooms: longer than those of the package, before the shoulders on most
BEFORE, BODY = 0.11, -0.11  # metres: as far behind clothes and chest hair before them may be, and height below which these are
OFTEN = ["stubble", "stubble", "full", "full"]  # beards beside one of each kind
VISIBLE = 0.2  # of the skin's color that a beard or brow must change to be seen: shade under a chin is none
NAMES = list(MESH_PARTS)


@dataclass(frozen=True)
class Sample:
    """A picture for the parser: display sRGB, mask and validity uint8 [5, S, S]; `mesh_channels` float16; labels uint8."""

    picture: np.ndarray
    mesh: np.ndarray
    labels: np.ndarray


class Maker:
    """Makes samples; `held_out`: of other people than those to learn from."""

    def __init__(self, head: HeadModel, held_out: bool) -> None:
        self.head, self._people = head, People(head, held_out)
        self._grooms: list[tuple[tuple[StrandBlock, ...], bool]] = []
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def refresh(self, g: Generator, people: int, grooms: int) -> None:
        """Take other people and grooms; making one ready takes a while, so that each serves for many pictures."""
        self._people.exchange(g, people)
        self._grooms = []
        for _ in range(grooms):
            long = g.random() < LONG
            parts = blocks_of(long_hair(self.head, g, DETAIL[SCALP]), self.head.v_template, self.head.faces) if long else ()
            for group, name in enumerate(GROUPS):
                if not (long and group == SCALP) and (group != BEARD or g.random() < BEARDED):
                    names = list(groom_names(name)) + (OFTEN if group == BEARD else [])
                    groom = library_groom(names[int(g.integers(len(names)))], part=name).level(DETAIL[group])
                    parts += blocks_of(groom, self.head.v_template, self.head.faces)
            self._grooms.append((parts, long))

    def make(self, g: Generator) -> Sample:
        """Draw a picture."""
        before, posed = self._last, self._people.posed(g)
        drawn, limits = self._base(posed, g)
        skin, found = self._label(drawn, posed.vertices)
        if g.random() < 0.45:
            make_up(drawn, posed.vertices, self.head, g)
        if g.random() < 0.35:
            shade_throat(drawn, g)
        blocks, long = self._grooms[int(g.integers(len(self._grooms)))]
        settings = drawn_settings(g)
        if long:
            settings = settings.changed(length=float(g.uniform(0.75, 1.2)), curl=settings.curl * float(g.random()))
        beard = _beard_settings(settings, g)
        hair = _hair_color(settings)
        bald = g.random() < 0.07
        _paint_scalp(drawn, found, skin, None if bald or g.random() < 0.05 else hair, g.uniform(0.35, 0.95))
        hat = Hat(g) if g.random() < 0.4 else None
        hiding = dress(drawn, self.head, posed.vertices, g, skin, hair)
        if long and g.random() < 0.75:
            low = unprojected(hiding, drawn.camera)[..., 1] < BODY
            hiding = np.where(low, hiding + BEFORE, hiding)
        self._hair(drawn, posed.vertices, blocks, {SCALP: settings, BEARD: beard}, hat, bald, hiding)
        if g.random() < 0.28:
            glasses(drawn, self.head, posed.vertices, g)
        if hat is not None:
            hat.draw(drawn, self.head, posed.vertices, g, skin, hair)
        mouth = drawn.camera.project(posed.vertices[self.head.regions["lips"]].mean(0)[None])[1][0]
        if g.random() < 0.4:
            occluder(drawn, g, skin, hair, mouth)
        if g.random() < 0.05:
            leaves(drawn, g, skin, hair, mouth)
        cover = drawn.cover.copy()
        image = lit(drawn, posed.light, g)
        self._last = image * cover[..., None], cover
        ground = background(g, skin, hair) * (g.uniform(1.2, 3.0) if posed.light.backlit else np.exp(g.normal(0, 0.3)))
        if before is not None and g.random() < 0.25:
            ground = _neighbour(*before, ground, g)
        if g.random() < 0.5:
            ground = blurred(ground, g.uniform(0.5, 5.0))
        image = image * cover[..., None] + np.clip(ground, 0, 1.3) * (1 - cover[..., None])
        return self._sample(posed, image, drawn, cover, limits, g)

    def _base(self, posed: Posed, g: Generator) -> tuple[Drawn, np.ndarray]:
        """Cut the frame of a working picture out of a view, a little off and turned."""
        layers = [
            posed.color * posed.cover[..., None],
            posed.cover[..., None],
            posed.normals,
            posed.lit * posed.cover[..., None],
        ]
        stack = torch.from_numpy(np.concatenate(layers, -1).astype(np.float32)).permute(2, 0, 1)[None]
        camera = posed.camera
        border = np.concatenate([posed.cover[0], posed.cover[:, 0], posed.cover[:, -1]]).max() > 0.1
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
        fine = 2 if side < 1.1 * posed.camera.width else 1
        at = (np.arange(size * fine) + 0.5) / fine / factor
        u, v = np.meshgrid(left + at - camera.cx, top + at - camera.cy)
        u, v = c * u + s * v + camera.cx, c * v - s * u + camera.cy
        places = np.stack([u / posed.camera.width, v / posed.camera.height], -1) * 2 - 1
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
        cover = taken[..., 3]
        color, light = (taken[..., first : first + 3] / np.maximum(cover[..., None], 1e-4) for first in (0, 7))
        normals, depth = unit(taken[..., 4:7]), self._people.depth(posed, camera)
        drawn = Drawn(camera, color, np.zeros((size, size), np.uint8), cover, normals, depth, light)
        return drawn, inside if border else np.ones_like(inside)

    def _label(self, drawn: Drawn, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Label the head itself; returns the color of its skin [3] and the parts of the mesh [S, S]."""
        found, _ = part_map(self.head, vertices, drawn.camera)
        table = np.array([*(LABELS.index(name if name != "scalp" and name != "brows" else "skin") for name in NAMES), 0])
        drawn.labels = np.where(drawn.cover > 0.5, table[np.where(found < 0, NAMES.index("skin"), found)], 0).astype(np.uint8)
        face = (found == NAMES.index("skin")) & (drawn.cover > 0.9) & (drawn.labels == LABELS.index("skin"))
        return np.median(drawn.color[face], axis=0) if face.any() else np.array([0.3, 0.17, 0.1]), found

    def _hair(
        self,
        drawn: Drawn,
        vertices: np.ndarray,
        blocks: tuple[StrandBlock, ...],
        settings: dict[int, HairSettings],
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
            own = settings.get(block.group) or _darker(settings[SCALP])
            points = np.matmul(block.styled(own), axes) + origin[:, None]
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
        before, skin = drawn.color.sum(-1), drawn.bare
        drawn.falling = drawn.lit / np.maximum(drawn.color, 1e-3)
        drawn.lay(cover, picture.rgb / np.maximum(cover[..., None], 1e-4), None, unit(out))
        changed = np.abs(drawn.color.sum(-1) - before) / np.maximum(before, 1e-3)
        visible = blurred(changed[..., None], 1.5)[..., 0] > VISIBLE
        most = picture.features.argmax(-1)
        drawn.downy = (most != SCALP) * cover * skin
        for number, name in enumerate(("hair", "brows", "beard", "eyes")):
            there = (most == number) & (cover > (0.3 if name == "brows" else 0.4))
            if name != "eyes":
                drawn.labels[there & (visible | (name == "hair"))] = LABELS.index(name)

    def _sample(
        self, posed: Posed, image: np.ndarray, drawn: Drawn, cover: np.ndarray, inside: np.ndarray, g: Generator
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
        shape = posed.shape * g.uniform(0.4, 1.0) + g.normal(0, 0.25, len(posed.shape)) * (np.arange(len(posed.shape)) < 40)
        pose = posed.pose + g.normal(0, 0.02, posed.pose.shape) * [[0], [1], [1], [1], [1]]
        vertices = self.head.vertices(shape, posed.expression * g.uniform(0.7, 1.1), pose)
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


def _neighbour(image: np.ndarray, cover: np.ndarray, ground: np.ndarray, g: Generator) -> np.ndarray:
    """Somebody else in the background, with hair and clothes: premultiplied [S, S, 3] and cover [S, S], moved aside."""
    shift = (int(g.integers(-20, 20)), int(g.choice([-1, 1])) * int(g.integers(35, 85)))
    moved, there = np.roll(image, shift, (0, 1)), np.roll(cover, shift, (0, 1))
    if g.random() < 0.5:
        moved, there = moved[:, ::-1], there[:, ::-1]
    return ground * (1 - there[..., None]) + moved * np.exp(g.normal(0, 0.5))


def drawn_settings(g: Generator) -> HairSettings:
    """Of scalp hair by chance."""
    dyed = g.random() < 0.06
    return HairSettings(
        length=float(g.choice([g.uniform(0.15, 0.45), np.clip(np.exp(g.normal(0.0, 0.35)), 0.2, 1.6)], p=[0.35, 0.65])),
        density=float(g.choice([1.0, g.uniform(0.4, 1.0)])),
        thickness=g.uniform(0.8, 1.6), curl=g.uniform(-0.6, 0.8), frizz=g.random() ** 2, melanin=g.beta(1.6, 1.1),
        redness=g.random() ** 3, grey=float(g.choice([0.0, g.random(), 1.0], p=[0.55, 0.25, 0.2])), variation=g.random(),
        tips=g.uniform(-0.3, 0.5), dye=0.9 if dyed else 0.0, dye_red=g.random(), dye_green=g.random(), dye_blue=g.random(),
        sheen=g.uniform(0.0, 2.2),
    )  # fmt: skip


def _darker(scalp: HairSettings) -> HairSettings:
    """Of brows, lashes and beard beside scalp hair."""
    return scalp.changed(length=1.0, density=1.0, grey=scalp.grey * 0.6, melanin=min(1.0, scalp.melanin + 0.1))


def _beard_settings(scalp: HairSettings, g: Generator) -> HairSettings:
    """Of a beard: from shaved yesterday to one that hangs on the chest."""
    longer = float(np.clip(np.exp(g.normal(0.0, 0.5)), 0.3, 3.0)) if g.random() < 0.55 else float(g.uniform(2.0, 5.0))
    return _darker(scalp).changed(length=longer, density=float(g.choice([1.0, g.uniform(0.3, 1.0)])))


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
    painted = drawn.color * (1 - scalp) + scalp * np.clip(shade, 0.3, 2.0) * tone
    drawn.lit = drawn.lit * painted / np.maximum(drawn.color, 1e-3)
    drawn.color = painted
    if hair is not None:
        drawn.labels[(found == NAMES.index("scalp")) & (drawn.cover > 0.5)] = LABELS.index("hair")
