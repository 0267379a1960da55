"""One Blender scene: head mesh, strands, materials, lights, cameras, and a picture read back as arrays. Imports bpy.

The mesh and its materials are made once per person; a shot rewrites positions only; a view moves the camera only.
"""

from __future__ import annotations

import atexit
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from grmm_core.data.types import Picture
from grmm_core.geometry.camera import Camera
from grmm_core.hair.groom import Groom
from grmm_core.hair.roots import BEARD, BROWS, LASHES, SCALP
from grmm_core.head import HeadModel
from grmm_core.light.cornea import EYEBALLS
from grmm_core.light.eye_shade import lid_edges, lids_leave
from grmm_core.light.mouth_shade import depth_leaves

from . import fields
from .flesh import Flesh
from .grooming import make_groom
from .lamps import Lamps, look_at
from .lights import RIG, Light
from .materials import eye_material, hair_material, skin_material, teeth_material, tongue_material
from .mesh import RenderMesh, region_vertices
from .passes import Passes, silence_exit
from .strands import HairObjects, to_blender
from .subjects import Subject, hair_albedo
from .teeth import TeethAtlas, TeethTextures, paint_teeth
from .textures import Atlas, SkinTextures, paint_skin
from .wrinkles import LineField


@dataclass
class _Prepared:
    """What is expensive to make of a person, kept for the rounds of a capture."""

    neutral: np.ndarray
    textures: SkinTextures
    teeth: TeethTextures
    groom: Groom


class Studio:
    """The scene of one process."""

    def __init__(
        self,
        head: HeadModel,
        size: int,
        samples: int,
        subsurface: bool = True,
        layers: bool = False,
        threads: int = 2,
        texture_size: int = 768,
    ) -> None:
        atexit.register(silence_exit)
        bpy.ops.wm.read_homefile(use_empty=True)
        self.head = head
        self.mesh = RenderMesh.build(head)
        self.size = size
        balls = np.flatnonzero(np.maximum(*(self._mask(name) for name in EYEBALLS)) > 0.99)
        self._eyes = balls, lid_edges(head, np.sign(self.mesh.spread(np.asarray(head.v_template, float))[balls, 0]))
        self._atlas, self._teeth = Atlas.build(head, texture_size), TeethAtlas.build(head)
        self.subsurface = subsurface
        self.scene = bpy.context.scene
        self._folder = tempfile.TemporaryDirectory(prefix="grmm-capture-")
        self._configure(samples, threads)
        self._passes = Passes(self.scene, Path(self._folder.name), layers)
        self.light = RIG
        self._lamps = Lamps(self.scene)
        self._lamps.set(RIG)
        self._camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self.scene.collection.objects.link(self._camera)
        self.scene.camera = self._camera
        self._prepared: dict[str, _Prepared] = {}
        self._objects: list[Any] = []
        self._hair: HairObjects

    def close(self) -> None:
        """Remove temporary files."""
        self._folder.cleanup()

    def set_subject(self, subject: Subject) -> None:
        """Build everything of one person, on the neutral head."""
        for item in self._objects:
            data = item.data
            bpy.data.objects.remove(item)
            bpy.data.meshes.remove(data)
        if self._objects:
            self._hair.remove()
        for material in list(bpy.data.materials):
            bpy.data.materials.remove(material)
        self._objects = []
        self._subject = subject
        prepared = self._prepared.get(subject.name)
        if prepared is None:
            prepared = self._prepared[subject.name] = self._prepare(subject)
        self._neutral, self.groom = prepared.neutral, prepared.groom
        self._flesh = Flesh(subject, self.head, self._neutral)
        self._add_mesh(subject, prepared)
        brow = tuple(0.62 * c + 0.38 * d for c, d in zip(subject.hair_color, hair_albedo(0.8, 0, 0), strict=True))
        looks = {
            SCALP: hair_material("hair", subject.hair_color, 0.32), BROWS: hair_material("brows", brow, 0.3),
            BEARD: hair_material("beard", brow, 0.3), LASHES: hair_material("lashes", tuple(hair_albedo(0.95, 0.0, 0.0)), 0.1),
        }  # fmt: skip
        self._hair = HairObjects(self.head, self._neutral, prepared.groom, looks, subject.asymmetry)

    def _prepare(self, subject: Subject) -> _Prepared:
        neutral = np.asarray(self.head.vertices(subject.shape, np.zeros(1), np.zeros((5, 3))), np.float64)
        return _Prepared(
            neutral,
            paint_skin(subject, self._atlas),
            paint_teeth(subject, self._teeth),
            make_groom(self.head, self.mesh, neutral, subject),
        )

    def set_shot(self, expression: np.ndarray, pose: np.ndarray, light: Light = RIG) -> np.ndarray:
        """Pose the person; returns the vertices [V, 3] in head space. `displacement` is what they have beyond the mesh model.

        Args:
            expression: Head-model coefficients, [E].
            pose: Euler angles of the five joints, radians, [5, 3].
            light: Of the shot.
        """
        subject = self._subject
        model = np.asarray(self.head.vertices(subject.shape, expression, pose), np.float64)
        self.displacement = self._flesh.displacement(model, self.mesh.normals(model), expression, pose)
        posed = model + self.displacement
        fine = self.mesh.refine(posed)
        mesh = self._objects[0].data
        mesh.vertices.foreach_set("co", to_blender(fine).astype(np.float32).ravel())
        mesh.attributes["wrinkle"].data.foreach_set("value", self._wrinkles(posed).astype(np.float32))
        mesh.attributes["lids"].data.foreach_set("value", self._between_lids(fine, posed))
        lines, blood = self._lines.amounts(expression)
        mesh.attributes["lines"].data.foreach_set("vector", lines.astype(np.float32).ravel())
        mesh.attributes["blood"].data.foreach_set("vector", blood.astype(np.float32).ravel())
        mesh.update()
        self._posed, self._combed = posed, False
        self.light = light
        self._lamps.set(light)
        return posed

    def render(self, camera: Camera, hair: bool = True, light: Light | None = None) -> Picture:
        """Picture of the present shot, with or without hair, in the light of the shot or another."""
        _place_camera(self._camera, camera)
        self.scene.render.resolution_x, self.scene.render.resolution_y = camera.width, camera.height
        if hair and not self._combed:  # some 30,000 strands: only where they are seen
            self._hair.pose(self._posed)
            self._combed = True
        self._hair.show(hair)
        if light is not None:
            self._lamps.set(light)
        picture = self._passes.render()
        if light is not None:
            self._lamps.set(self.light)
        return picture

    def _configure(self, samples: int, threads: int) -> None:
        scene = self.scene
        scene.render.engine = "CYCLES"
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.samples = samples
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = True
        cycles.denoiser = "OPENIMAGEDENOISE"
        cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
        cycles.denoising_prefilter = "NONE"
        cycles.denoising_quality = "FAST"
        scene.cycles_curves.shape = "RIBBONS"
        scene.cycles_curves.subdivisions = 2
        cycles.max_bounces = 2
        cycles.diffuse_bounces = 1
        cycles.glossy_bounces = 1
        cycles.transmission_bounces = 2
        cycles.transparent_max_bounces = 8
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.sample_clamp_indirect = 3.0
        cycles.seed = 1
        cycles.pixel_filter_type = "BLACKMAN_HARRIS"
        cycles.filter_width = 1.3
        scene.render.use_persistent_data = True
        scene.render.film_transparent = True
        scene.render.threads_mode, scene.render.threads = "FIXED", threads
        scene.render.resolution_percentage = 100
        scene.view_settings.view_transform = "Standard"
        scene.render.image_settings.file_format = "PNG"
        scene.render.filepath = str(Path(self._folder.name) / "unused.png")

    def _add_mesh(self, subject: Subject, prepared: _Prepared) -> None:
        render = self.mesh
        template = np.asarray(self.head.v_template, float)
        fine = render.refine(self._neutral)
        mesh = bpy.data.meshes.new("head")
        mesh.from_pydata(to_blender(fine).tolist(), [], render.faces.tolist())
        mesh.polygons.foreach_set("material_index", render.materials.astype(np.int32))
        mesh.polygons.foreach_set("use_smooth", np.ones(len(render.faces), bool))
        for material in (
            skin_material(subject, prepared.textures, self.subsurface),
            eye_material(subject),
            teeth_material(subject, prepared.teeth, self._teeth.share),
            tongue_material(subject),
        ):
            mesh.materials.append(material)
        rest = render.refine(template)
        line, _ = fields.wrinkle_lines(rest)
        self._age_lines = line * 0.55 * subject.wrinkles**1.5
        self._move_lines = line
        base = self._neutral[render.coarse_faces]
        self._rest_area = np.linalg.norm(np.cross(base[:, 1] - base[:, 0], base[:, 2] - base[:, 0]), axis=1)
        values = {
            "wrinkle": self._age_lines,
            "mouth": self._mask("mouth_interior"),
            "lids": np.ones(len(rest)),
            "depth": np.ones(len(rest)) if (leaves := depth_leaves(self.head)) is None else self.mesh.spread(leaves),
        }
        for name, value in values.items():
            attribute = mesh.attributes.new(name, "FLOAT", "POINT")
            attribute.data.foreach_set("value", np.ascontiguousarray(value, np.float32))
        skin = self._mask("skin") * (1 - values["mouth"])
        self._lines = LineField.build(subject, rest, skin, self._mask("lips") * skin)
        vectors = {"rest": self._shader_rest(rest), "lines": np.zeros(rest.shape), "blood": np.ones(rest.shape)}
        for name, value in vectors.items():
            attribute = mesh.attributes.new(name, "FLOAT_VECTOR", "POINT")
            attribute.data.foreach_set("vector", np.ascontiguousarray(value, np.float32).ravel())
        layer = mesh.uv_layers.new(name="uv")
        layer.uv.foreach_set("vector", render.corner_uv(self.head).astype(np.float32).ravel())
        mesh.update()
        item = bpy.data.objects.new("head", mesh)
        self.scene.collection.objects.link(item)
        self._objects.append(item)

    def _mask(self, region: str) -> np.ndarray:
        flags = np.zeros(len(self.head.v_template))
        if region == "skin":
            flags[:] = 1
            for name in ("left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes"):
                flags[region_vertices(self.head, name)] = 0
        else:
            flags[region_vertices(self.head, region)] = 1
        return self.mesh.spread(flags)

    def _shader_rest(self, rest: np.ndarray) -> np.ndarray:
        result = rest.copy()
        for name in EYEBALLS:
            own = self._mask(name) > 0.99
            if own.any():
                points = rest[own]
                centre = 0.5 * (points.min(0) + points.max(0))
                result[own] = (points - centre) / np.linalg.norm(points - centre, axis=1, keepdims=True)
        return result

    def _between_lids(self, fine: np.ndarray, posed: np.ndarray) -> np.ndarray:
        """Light that lids leave to eyeballs (`light.eye_shade`), [fine vertices] float32."""
        balls, edges = self._eyes
        light = np.ones(len(fine), np.float32)
        light[balls] = lids_leave(fine[balls].astype(np.float32), posed.astype(np.float32), edges)
        return light

    def _wrinkles(self, posed: np.ndarray) -> np.ndarray:
        """Lines of age plus lines where the skin is compressed, [fine vertices]."""
        p = posed[self.mesh.coarse_faces]
        area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        shrink = 1.0 - area / np.maximum(self._rest_area, 1e-12)
        flat = self.mesh.coarse_faces.ravel()
        count = np.maximum(np.bincount(flat, minlength=len(posed)), 1)
        vertex = np.bincount(flat, np.repeat(shrink, 3), len(posed)) / count
        press = np.clip(self.mesh.spread(np.clip(vertex, 0, 0.5)) * 2.6, 0, 1)
        return np.clip(self._age_lines + press * self._move_lines * (0.45 + 0.55 * self._subject.wrinkles), 0, 1)


def _place_camera(item: Any, camera: Camera) -> None:
    item.matrix_world = look_at(camera)
    data = item.data
    data.type = "PERSP"
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.lens = 36.0 * camera.fx / camera.width
    data.clip_start, data.clip_end = 0.05, 20.0
    data.shift_x = (camera.width / 2 - camera.cx) / camera.width
    data.shift_y = (camera.cy - camera.height / 2) / camera.width
