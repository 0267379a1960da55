"""One Blender scene: head mesh, strands, materials, lights, cameras, and a picture read back as arrays. Imports bpy.

The mesh and its materials are made once per person; a shot rewrites positions only; a view moves the camera only.
"""

from __future__ import annotations

import atexit
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from scipy.spatial import cKDTree

from grmm_core.geometry.camera import Camera

from . import fields
from .face_hair import face_strands, scalp_strands
from .hair import Ribbons, Strands
from .lashes import Lashes
from .materials import eye_material, hair_material, skin_material, teeth_material, tongue_material
from .mesh import Head, RenderMesh, region_vertices
from .subjects import Subject, hair_albedo
from .textures import Atlas, SkinTextures, paint_skin
from .wrinkles import LineField

LASH_TINT = 50.0  # strands of a larger tint are lashes
LOCKS = 260  # of the scalp hair that differ in color
UPPER_GUM, LOWER_GUM = 0.0105, 0.0095  # crown heights in metres from the tips


def to_blender(points: np.ndarray) -> np.ndarray:
    """Head space (y up, face +z) to Blender (z up, face -y), [..., 3]."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], -1)


@dataclass
class _Prepared:
    """What is expensive to make of a person, kept for the rounds of a capture."""

    neutral: np.ndarray
    textures: SkinTextures
    face: Strands
    scalp: Strands | None


class Studio:
    """The scene of one process."""

    def __init__(
        self,
        head: Head,
        size: int,
        samples: int,
        varied_light: bool = False,
        subsurface: bool = True,
        threads: int = 2,
        texture_size: int = 768,
    ) -> None:
        atexit.register(_silence_exit)
        bpy.ops.wm.read_homefile(use_empty=True)
        self.head = head
        self.mesh = RenderMesh.build(head)
        self.size = size
        self._atlas = Atlas.build(head, texture_size)
        self.subsurface = subsurface
        self.varied_light = varied_light
        self.scene = bpy.context.scene
        self._folder = tempfile.TemporaryDirectory(prefix="grmm-capture-")
        self._configure(samples, threads)
        self._lights: list[Any] = []
        self._make_light()
        self._camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self.scene.collection.objects.link(self._camera)
        self.scene.camera = self._camera
        self._subject: Subject | None = None
        self._prepared: dict[str, _Prepared] = {}
        self._objects: list[Any] = []
        self._strands: list[tuple[Any, Strands | Lashes, Ribbons]] = []

    def close(self) -> None:
        """Remove temporary files."""
        self._folder.cleanup()

    def set_subject(self, subject: Subject) -> None:
        """Build everything of one person, on the neutral head."""
        for item in self._objects:
            data = item.data
            bpy.data.objects.remove(item)
            bpy.data.meshes.remove(data)
        for material in list(bpy.data.materials):
            bpy.data.materials.remove(material)
        self._objects, self._strands = [], []
        self._subject = subject
        prepared = self._prepared.get(subject.name)
        if prepared is None:
            prepared = self._prepared[subject.name] = self._prepare(subject)
        self._neutral = prepared.neutral
        self._add_mesh(subject, prepared.textures)
        lash = hair_albedo(0.95, 0.0, 0.0)
        brow = tuple(0.62 * c + 0.38 * d for c, d in zip(subject.hair_color, hair_albedo(0.8, 0, 0), strict=True))
        face, scalp = prepared.face, prepared.scalp
        dark = face.tint > LASH_TINT
        lashes = Lashes.build(self.head, self._neutral, _select(face, dark))
        self._add_strands("lashes", lashes, hair_material("lashes", tuple(lash), 0.1, 0.0))
        self._add_strands("brows", _select(face, ~dark), hair_material("brows", brow, 0.3, 0.0))
        if scalp is not None:
            self._add_strands("hair", scalp, hair_material("hair", subject.hair_color, 0.32, 0.35))

    def _prepare(self, subject: Subject) -> _Prepared:
        neutral = np.asarray(self.head.vertices(subject.shape, np.zeros(1), np.zeros((5, 3))), float)
        return _Prepared(
            neutral,
            paint_skin(subject, self._atlas),
            face_strands(self.head, self.mesh, neutral, subject),
            scalp_strands(self.head, self.mesh, neutral, subject),
        )

    def set_shot(self, expression: np.ndarray, pose: np.ndarray, light_seed: int = 0) -> np.ndarray:
        """Pose the person; returns the model's vertices [V, 3] in head space.

        Args:
            expression: Head-model coefficients, [E].
            pose: Euler angles of the five joints, radians, [5, 3].
            light_seed: Draws the light where the studio varies it.
        """
        subject = self._subject
        posed = np.asarray(self.head.vertices(subject.shape, expression, pose), float)
        fine = self.mesh.refine(posed)
        mesh = self._objects[0].data
        mesh.vertices.foreach_set("co", to_blender(fine).astype(np.float32).ravel())
        mesh.attributes["wrinkle"].data.foreach_set("value", self._wrinkles(posed).astype(np.float32))
        lines, blood = self._lines.amounts(expression)
        mesh.attributes["lines"].data.foreach_set("vector", lines.astype(np.float32).ravel())
        mesh.attributes["blood"].data.foreach_set("vector", blood.astype(np.float32).ravel())
        mesh.update()
        for item, strands, ribbons in self._strands:
            corners = ribbons.vertices(strands.points(posed), strands.radius, fields.HEAD_CENTRE)
            item.data.vertices.foreach_set("co", to_blender(corners).astype(np.float32).ravel())
            item.data.update()
        if self.varied_light:
            self._vary_light(light_seed)
        return posed

    def render(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Picture of the present shot.

        Returns:
            Straight display-sRGB color 0..1 [H, W, 3], alpha 0..1 [H, W], depth in metres [H, W] (0: background).
        """
        _place_camera(self._camera, camera)
        self.scene.render.resolution_x, self.scene.render.resolution_y = camera.width, camera.height
        with _quiet():
            bpy.ops.render.render()
        folder = Path(self._folder.name)
        rgba = _read_exr(folder / "rgba0001.exr")
        z = _read_exr(folder / "depth0001.exr")[..., 0]
        alpha = np.clip(rgba[..., 3], 0.0, 1.0)
        straight = rgba[..., :3] / np.maximum(alpha, 1e-4)[..., None]
        color = linear_to_srgb(np.clip(straight, 0.0, 1.0))
        depth = np.where((alpha > 0.25) & (z < 50.0), z, 0.0)
        return color.astype(np.float32), alpha.astype(np.float32), depth.astype(np.float32)

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
        cycles.debug_use_spatial_splits = True  # strands are long thin triangles
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
        scene.view_layers[0].use_pass_z = True
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        layers = tree.nodes.new("CompositorNodeRLayers")
        output = tree.nodes.new("CompositorNodeOutputFile")
        output.base_path = self._folder.name
        output.format.file_format = "OPEN_EXR"
        output.format.color_mode = "RGBA"
        output.format.color_depth = "32"
        output.format.exr_codec = "NONE"
        output.file_slots.clear()
        for slot, socket in (("rgba", "Image"), ("depth", "Depth")):
            output.file_slots.new(slot)
            tree.links.new(layers.outputs[socket], output.inputs[slot])

    def _make_light(self) -> None:
        world = bpy.data.worlds.new("world")
        self.scene.world = world
        world.use_nodes = True
        background = world.node_tree.nodes["Background"]
        background.inputs[0].default_value = (1.0, 1.0, 1.0, 1.0)
        background.inputs[1].default_value = 0.42
        self._background = background
        # yaw, pitch, distance, side (m), power (W): a ring of soft boxes, a slightly stronger one at the front left
        rig = (
            (32, 28, 1.5, 0.9, 16.0),
            (-42, 18, 1.5, 0.9, 9.0),
            (120, 25, 1.6, 1.1, 8.0),
            (-120, 25, 1.6, 1.1, 8.0),
            (0, 75, 1.5, 1.0, 7.0),
            (180, 10, 1.7, 1.0, 6.0),
        )
        for i, (yaw, pitch, distance, side, power) in enumerate(rig):
            light = bpy.data.lights.new(f"soft{i}", "AREA")
            light.shape, light.size, light.energy = "SQUARE", side, power
            item = bpy.data.objects.new(light.name, light)
            item.visible_camera = False
            item.matrix_world = _look_at(Camera.orbit(8, 8, yaw, pitch, distance))
            self.scene.collection.objects.link(item)
            self._lights.append((item, power))

    def _vary_light(self, seed: int) -> None:
        g = np.random.default_rng([seed, 31])
        self._background.inputs[1].default_value = float(g.uniform(0.15, 0.6))
        for item, power in self._lights:
            item.data.energy = power * float(np.exp(g.normal(0, 0.6)))
            warm = g.normal(0, 0.10)
            item.data.color = (1.0, 1.0 - 0.5 * abs(warm), 1.0 - warm) if warm > 0 else (1.0 + warm, 1.0 - 0.3 * abs(warm), 1.0)
            item.matrix_world = _look_at(Camera.orbit(8, 8, float(g.uniform(-180, 180)), float(g.uniform(-10, 75)), 1.5))

    def _add_mesh(self, subject: Subject, textures: SkinTextures) -> None:
        render = self.mesh
        template = np.asarray(self.head.v_template, float)
        fine = render.refine(self._neutral)
        mesh = bpy.data.meshes.new("head")
        mesh.from_pydata(to_blender(fine).tolist(), [], render.faces.tolist())
        mesh.polygons.foreach_set("material_index", render.materials.astype(np.int32))
        mesh.polygons.foreach_set("use_smooth", np.ones(len(render.faces), bool))
        for material in (
            skin_material(subject, textures, self.subsurface),
            eye_material(subject),
            teeth_material(subject),
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
            "arc": fields.tooth_arc(rest),
            "crown": self._crowns(rest),
            "mouth": self._mask("mouth_interior"),
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

    def _crowns(self, rest: np.ndarray) -> np.ndarray:
        """Metres from the gum line towards the tips, on the teeth."""
        crown = np.zeros(len(rest))
        for name, height, sign in (("upper_teeth", UPPER_GUM, 1.0), ("lower_teeth", LOWER_GUM, -1.0)):
            own = self._mask(name) > 0.99
            if own.any():
                y = sign * rest[own, 1]
                crown[own] = y.min() + height - y
        return crown

    def _shader_rest(self, rest: np.ndarray) -> np.ndarray:
        result = rest.copy()
        for name in ("left_eyeball", "right_eyeball"):
            own = self._mask(name) > 0.99
            if own.any():
                points = rest[own]
                centre = 0.5 * (points.min(0) + points.max(0))
                result[own] = (points - centre) / np.linalg.norm(points - centre, axis=1, keepdims=True)
        return result

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

    def _add_strands(self, name: str, strands: Strands | Lashes, material: bpy.types.Material) -> None:
        if not len(strands.faces):
            return
        count, steps = strands.local.shape[:2]
        ribbons = Ribbons.build(count, steps, self._subject.asymmetry)
        data = bpy.data.meshes.new(name)
        corners = to_blender(ribbons.vertices(strands.points(self._neutral), strands.radius, fields.HEAD_CENTRE)).astype(
            np.float32
        )
        data.vertices.add(len(corners))
        data.vertices.foreach_set("co", corners.ravel())
        data.loops.add(ribbons.faces.size)
        data.loops.foreach_set("vertex_index", ribbons.faces.ravel().astype(np.int32))
        data.polygons.add(len(ribbons.faces))
        data.polygons.foreach_set("loop_start", np.arange(0, ribbons.faces.size, 3, dtype=np.int32))
        data.polygons.foreach_set("use_smooth", np.ones(len(ribbons.faces), bool))
        g = np.random.default_rng(self._subject.asymmetry + 1)
        tint = np.repeat(np.clip(0.5 + 0.2 * _locks(strands, self._neutral, g) + 0.08 * g.normal(0, 1, count), 0, 1), 2 * steps)
        along = np.tile(np.repeat(np.linspace(0, 1, steps), 2), count)
        for key, value in (("tint", tint), ("along", along)):
            data.attributes.new(key, "FLOAT", "POINT").data.foreach_set("value", value.astype(np.float32))
        data.update(calc_edges=True)
        data.materials.append(material)
        item = bpy.data.objects.new(name, data)
        self.scene.collection.objects.link(item)
        self._objects.append(item)
        self._strands.append((item, strands, ribbons))


def _silence_exit() -> None:
    """At the end of the process Blender reports a few bytes of its own on the standard output, after our result."""
    sys.stdout.flush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


@contextmanager
def _quiet() -> Iterator[None]:
    """Drop what Blender's own code writes to the standard output: the command line keeps that for results."""
    sys.stdout.flush()
    saved = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """Display sRGB of linear values 0..1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(np.maximum(linear, 1e-8), 1 / 2.4) - 0.055)


def _locks(strands: Strands | Lashes, neutral: np.ndarray, g: np.random.Generator) -> np.ndarray:
    """Normal numbers that strands with neighbouring tips share, [N]: hair differs by lock more than by strand."""
    tips = strands.points(neutral)[:, -1]
    return g.normal(0, 1, LOCKS)[cKDTree(tips[g.integers(len(tips), size=LOCKS)]).query(tips)[1]]


def _select(strands: Strands, mask: np.ndarray) -> Strands:
    return Strands(strands.faces[mask], strands.weights[mask], strands.local[mask], strands.radius[mask], strands.tint[mask])


def _read_exr(path: Path) -> np.ndarray:
    """Pixels [H, W, 4], first row on top."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]


def _look_at(camera: Camera) -> Matrix:
    """Blender object matrix of a camera in head space."""
    to_world = np.linalg.inv(np.asarray(camera.world_to_camera))
    turn = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return Matrix((turn @ to_world @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist())


def _place_camera(item: Any, camera: Camera) -> None:
    item.matrix_world = _look_at(camera)
    data = item.data
    data.type = "PERSP"
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.lens = 36.0 * camera.fx / camera.width
    data.clip_start, data.clip_end = 0.05, 20.0
    data.shift_x = (camera.width / 2 - camera.cx) / camera.width
    data.shift_y = (camera.cy - camera.height / 2) / camera.width
