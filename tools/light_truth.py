"""Hold relighting against Cycles: `python -m tools.light_truth DATA... [--sheet FILE]`.

DATA are captures with more lights: `grmm capture DATA --lights all --bare rest --layers ...`. Each view's picture in the even
rig is relit for each of its other lights, as avatars are: irradiance and highlights at the texels of the exact mesh, read at
each pixel, applied in linear light. So the figures are those of the light alone, not of a model's colors. The rig is taken off
as it lit the very picture; `--rest` takes it off as on the head at rest, which avatars' colors stand for. PSNR in dB, in the
mask and on the face without eyes and mouth; "unlit" is the picture in the rig held against the same truth. The studio's skin
scatters no light unless `--subsurface` was given, so scattering is off here, too; `--detail` is that of highlights.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from grmm_core.data.dataset import CaptureDataset
from grmm_core.data.layers import LIGHT_PREFIX
from grmm_core.data.types import Shot, View
from grmm_core.evaluation.regions import region_pixels, triangle_groups
from grmm_core.hair.drawing import Eye
from grmm_core.head import load_open_head
from grmm_core.light.bounce import Exchange, albedo_of, nearest_points
from grmm_core.light.lamps import STUDIO, Lighting, soft_box
from grmm_core.light.materials import materials_of
from grmm_core.light.mesh_light import LitSurface, TexelGrid
from grmm_core.light.relight import relit_pixels
from grmm_core.light.resting import Texels, casters_of, casting_numbers
from grmm_core.light.shading import NO_TILTS, Arrived, Response, ratio, shade, weight
from grmm_core.light.shadows import Casters, Receivers, visible
from grmm_core.light.skin_relief import VALUES, lying, softened
from grmm_core.light.surroundings import Surroundings, sphere
from grmm_core.light.transfer import transfer, turn_between, vertex_normals
from grmm_core.model.layout import texel_layout
from grmm_core.model.texels import TexelAnchor
from grmm_core.pictures.images import write_png
from grmm_core.splat import Gaussians, rasterize
from grmm_studio.lights import SETUPS, Light

GRID = 256
COLUMNS, SHOWN = 6, 160  # of the sheet, and pixels of its pictures
FEW = 1000  # pixels of a region: a view from behind says nothing of the face


@dataclass(frozen=True)
class _Surface:
    """Texels of a posed or resting head: its mesh, what they are for shadows, and their frames."""

    vertices: np.ndarray
    receivers: Receivers
    casters: Casters
    gaussians: Gaussians


class Relighter:
    """Relights the views of one capture; `posed` takes the rig off as it is on the posed head, else as on the head at rest."""

    def __init__(self, data: CaptureDataset, posed: bool = True, detail: float = 1.0) -> None:
        self._data, self._head, self._posed = data, load_open_head(), posed
        self._layout = texel_layout(self._head.uv, self._head.uv_faces, GRID)
        self._anchor = TexelAnchor(self._layout, self._head.faces, self._head.uv_faces, self._head.vertex_count)
        self._texels = Texels.of(self._head, self._layout.face, self._layout.barycentric)
        self._materials = materials_of(self._head, self._layout.face, self._layout.barycentric)
        self._groups = triangle_groups(self._head)
        self._response = Response(scattering=0.0, detail=detail)
        corners = self._head.faces[self._layout.face]
        cards = self._head.marked("lashes")[corners].all(1)  # captures have hairs instead
        self._opacities = torch.from_numpy(np.where(cards, 0.0, 0.97).astype(np.float32))
        self._near = nearest_points(corners, self._layout.barycentric, self._head.vertex_count)
        number, closed = casting_numbers(self._head)
        layout, faces = self._layout, self._head.faces[number]
        self._grid = TexelGrid.of(faces, layout.uv, self._head.uv_faces[number], layout.grid, layout.texel, int(closed))

    def results(self, shot: Shot, view: View) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
        """By the name of the light: relit picture, truth, picture in the rig, [H, W, 3] over black, and pixels by region."""
        picture = self._data.picture(shot, view)
        rest = np.asarray(self._head.vertices(self._data.shape(shot.subject), np.zeros(1), np.zeros((5, 3))), np.float64)
        posed = self._head.vertices(self._data.shape(shot.subject), shot.expression, shot.pose)
        still = self._surface(rest)
        here = self._surface(posed if shot.displacement is None else posed + shot.displacement)
        vertex_rows = transfer(still.vertices, vertex_normals(still.vertices, self._head.faces), still.casters.faces)
        rows = self._at_texels(vertex_rows)
        scalp = self._head.regions["scalp"]
        turn = turn_between(still.vertices[scalp], here.vertices[scalp])
        eye = view.camera.position
        learned_on = (here, rows, eye, turn) if self._posed else (still, rows, (eye - here.receivers.centre) @ turn, np.eye(3))
        held = self._light(STUDIO, *learned_on)
        rig, learned = held.irradiance, held.highlights
        skin = albedo_of(np.asarray(picture.over(0.0))[picture.mask > 0.9], rig)
        exchange = Exchange.of(rest, vertex_normals(rest, self._head.faces), self._head.faces, vertex_rows)

        def bounced(straight: np.ndarray) -> np.ndarray:
            return straight + self._at_texels(exchange.bounced(straight[self._near], skin))

        pixels = region_pixels(self._head, self._groups, here.vertices, view.camera, picture.mask, picture.depth)
        pixels = {"mask": picture.mask > 0.9, "face": pixels["face"] & (picture.mask > 0.9)}
        flat, found = np.asarray(picture.over(0.0), np.float32), {}
        for layer in view.layers:
            if layer.startswith(LIGHT_PREFIX):
                name = layer.removeprefix(LIGHT_PREFIX)
                relief = lying(self._head, rest, self._layout.uv, GRID, self._layout.face)
                tilts = np.empty((len(relief), VALUES + len(_softened(view))), np.float32)
                scene = self._light(lighting_of(SETUPS[name]), here, rows, eye, turn, tilts)
                relative = ratio(bounced(scene.irradiance), bounced(rig))
                light = np.concatenate([relative, scene.highlights - learned * relative, np.ones_like(scene.front)], 1)
                relit = self._draw(here, view, light * weight(scene.front, bounced(rig)), (tilts, relief), flat, picture.mask)
                truth = self._data.layer(shot, view, layer) * picture.mask[..., None]
                found[name] = (relit.clip(0.0, 1.0), truth, flat, pixels)
        return found

    def _surface(self, vertices: np.ndarray) -> _Surface:
        vertices = np.asarray(vertices, np.float32)
        frames = self._anchor(torch.from_numpy(vertices))
        sides = torch.cat([frames.sizes * 0.6, frames.sizes.amin(-1, keepdim=True) * 0.35], -1)
        gaussians = Gaussians(frames.positions, frames.quats, sides, self._opacities, torch.zeros(len(sides), 3))
        receivers = self._texels.receivers(vertices, vertex_normals(vertices, self._head.faces))
        return _Surface(vertices, receivers, casters_of(self._head, vertices), gaussians)

    def _at_texels(self, values: np.ndarray) -> np.ndarray:
        corners = self._head.faces[self._layout.face]
        return np.einsum("nk,nkc->nc", self._layout.barycentric, values[corners]).astype(np.float32)

    def _light(
        self, light: Lighting, surface: _Surface, rows: np.ndarray, eye: np.ndarray, turn: np.ndarray,
        tilts: np.ndarray = NO_TILTS,
    ) -> Arrived:  # fmt: skip
        lamps = light.shaded((0.0, 0.0, 0.0))
        seen = np.array([visible(lamp, surface.receivers, surface.casters) for lamp in lamps], np.float32)
        around = Surroundings.even((0.0, 0.0, 0.0)) if light.surroundings is None else light.surroundings.turned(turn.T)
        given = lamps, surface.receivers, seen, self._materials, rows, eye, around.coefficients
        return shade(*given, self._response, turn, tilts)

    def _draw(
        self, surface: _Surface, view: View, light: np.ndarray, fine: tuple[np.ndarray, np.ndarray], flat: np.ndarray,
        mask: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        channels = torch.from_numpy(light.astype(np.float32))
        drawn = rasterize(dataclasses.replace(surface.gaussians, features=channels), view.camera)
        assert drawn.features is not None
        light_here = drawn.features.numpy()
        surface_light = LitSurface(
            self._grid, surface.vertices, light.astype(np.float32), *fine, self._response.detail, _softened(view)
        )
        picture = drawn.depth.numpy(), drawn.alpha.numpy(), None, view.camera
        surface_light.read_into(light_here, slice(0, light.shape[1]), *picture)
        return relit_pixels(flat, mask, light_here, 0)


def _softened(view: View) -> np.ndarray:
    return softened(Eye.of(view.camera).pixels_per_metre())


def lighting_of(light: Light) -> Lighting:
    """The studio's light as avatars take it; the three colors of the world as `grmm_studio.lamps` blends them."""
    directions, solid = sphere(2000)
    height = 0.5 * (directions[:, 1] + 1.0)
    colors = np.array([light.ground, light.horizon, light.zenith])
    radiance = np.stack([np.interp(height, (0.40, 0.5, 0.75), colors[:, k]) for k in range(3)], -1) * light.strength
    lamps = tuple(soft_box(p.yaw, p.pitch, p.distance, p.side, p.power, p.color) for p in light.lamps)
    return Lighting(lamps, Surroundings.of_directions(directions, radiance, solid))


def measure(every: list[CaptureDataset], sheet: Path | None, posed: bool = True, detail: float = 1.0) -> dict[str, Any]:
    """Figures of all views; writes a sheet of the first bare one: truth, relit and unlit below each other."""
    kept = defaultdict(list)
    relighters = [Relighter(data, posed, detail) for data in every]
    for relighter, (shot, view) in ((one, item) for one, data in zip(relighters, every, strict=True) for item in data.views()):
        haired = view.bare is None or view.image != view.bare.image
        for kind, each in {"bare": view.bare, "hair": view if haired else None}.items():
            if each is None:
                continue
            results = relighter.results(shot, each)
            for name, (relit, truth, flat, pixels) in results.items():
                for region, where in pixels.items():
                    if where.sum() < FEW:
                        continue
                    for what, image in (("relit", relit), ("unlit", flat)):
                        kept[kind, region, what, name].append(float(-10 * np.log10(((image - truth)[where] ** 2).mean())))
            print(shot.subject, shot.number, kind, flush=True)
            if sheet is not None and kind == "bare":
                write_png(sheet, _sheet([result[:3] for result in results.values()]))
                sheet = None
    table: dict[str, Any] = {}
    for (kind, region, what, name), values in kept.items():
        table.setdefault(f"{kind} {region}", {}).setdefault(name, {})[what] = round(float(np.mean(values)), 2)
    for rows in table.values():
        rows["mean"] = {what: round(float(np.mean([row[what] for row in rows.values()])), 2) for what in ("relit", "unlit")}
    return table


def _sheet(columns: list[tuple[np.ndarray, ...]]) -> np.ndarray:
    from PIL import Image

    def small(picture: np.ndarray) -> np.ndarray:
        pixels = np.round(picture.clip(0.0, 1.0) * 255).astype(np.uint8)
        return np.asarray(Image.fromarray(pixels).resize((SHOWN, SHOWN), Image.Resampling.LANCZOS))

    stacks = [np.concatenate([small(picture) for picture in (truth, relit, flat)]) for relit, truth, flat in columns]
    rows = [np.concatenate(stacks[k : k + COLUMNS], 1) for k in range(0, len(stacks), COLUMNS)]
    return np.concatenate(rows)


def main() -> int:
    """Measure and print JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, nargs="+")
    parser.add_argument("--sheet", type=Path, help="PNG of the first view in all lights: Cycles, relit, and not relit")
    parser.add_argument("--rest", action="store_true", help="take the rig off as it lies on a head at rest")
    parser.add_argument("--detail", type=float, default=1.0, help="factor of pores and furrows in highlights (%(default)s)")
    args = parser.parse_args()
    every = [CaptureDataset(each) for each in args.data]
    json.dump(measure(every, args.sheet, not args.rest, args.detail), sys.stdout, indent=1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
