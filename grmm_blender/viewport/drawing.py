"""Draw calls of the splat viewport: Gaussians into buffers of their own, then into the viewport. Main thread only.

The buffers hold display colors, so that soft edges mix as in the rasteriser whatever the viewport's own buffer does, and 16
bits a channel, so that hundreds of thin layers do not lose precision.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix

from ...grmm_core.geometry.camera import Camera
from ...grmm_core.splat.rules import NEAR, View
from . import shaders
from .arrays import TEXTURE_WIDTH, WHOLE, Packed, Picture

DEPTH_COVER = 0.5  # from this cover on, splats hide what Blender draws later
PICTURE_SLACK = 0.05  # metres
SHOWN_COVER = 1.0 / 510.0
MESH_SLACK = 0.004  # of the distance: splats stay this much before the avatar's own mesh, whose pixels Blender jitters
ORTHO_SLACK = 0.006  # of the width that is seen: about as many pixels in a view without distances
_NOTHING = 1.0e10  # metres; depth where there is no mesh
_ORTHO_NEAR = -1.0e9  # an orthographic viewport sees what is behind its plane too


class _Buffers:
    """Textures of one size, and the frame buffers that draw into them."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.color = gpu.types.GPUTexture(size, format="RGBA16F")
        self.moment = gpu.types.GPUTexture(size, format="RGBA16F")
        self.mesh = gpu.types.GPUTexture(size, format="R32F")
        self.mesh_depth = gpu.types.GPUTexture(size, format="DEPTH_COMPONENT32F")  # a frame buffer does not keep it alive
        self.target = gpu.types.GPUFrameBuffer(color_slots=(self.color, self.moment))
        self.mesh_target = gpu.types.GPUFrameBuffer(depth_slot=self.mesh_depth, color_slots=(self.mesh,))


class SplatPicture:
    """Textures and buffers of one viewport."""

    def __init__(self) -> None:
        self._buffers: _Buffers | None = None
        self._shown: Picture | None = None
        self._small_textures: tuple[gpu.types.GPUTexture, ...] = ()
        self._packed: Packed | None = None
        self._splats: gpu.types.GPUTexture | None = None
        self._ordered: np.ndarray | None = None
        self._order: gpu.types.GPUTexture | None = None
        self._meshes: tuple[np.ndarray, ...] | None = None
        self._mesh_batch: gpu.types.GPUBatch | None = None
        self._mesh_origin = np.zeros(3)

    @functools.cached_property
    def _quad(self) -> gpu.types.GPUBatch:
        corners = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]], np.float32)
        return batch_for_shader(shaders.screen_shader(), "TRI_STRIP", {"corner": corners})

    def draw(
        self,
        packed: Packed,
        order: np.ndarray,
        camera: Camera,
        projection: np.ndarray,
        meshes: tuple[np.ndarray, ...] = (),
        moved: np.ndarray | None = None,
    ) -> None:
        """Draw into the buffer that is bound, of the camera's size, between the objects that are there already.

        Args:
            packed: Gaussians.
            order: Their order, see `arrays.depth_order`; of a slightly older camera is good enough.
            camera: Of the viewport.
            projection: OpenGL projection matrix of the viewport, [4, 4]: its depth is compared and written.
            meshes: World triangles [T, 3, 3] that the splats replace and Blender has drawn.
            moved: Rigid movement of the Gaussians since they were made, [4, 4] in the world; None for none.
        """
        if not len(packed):
            return
        self._upload(packed, order, meshes)
        buffers = self._sized(camera.width, camera.height)
        seen = camera if moved is None else camera.transformed(moved)
        reference = float(seen.world_to_camera[2, :3] @ packed.origin + seen.world_to_camera[2, 3])
        with _kept_state():
            self._draw_meshes(buffers, camera, projection)
            self._draw_splats(buffers, packed, seen, reference)
            self._draw_screen((buffers.color, buffers.moment, buffers.mesh), camera, projection, reference)

    def draw_picture(self, picture: Picture, camera: Camera, projection: np.ndarray) -> None:
        """Draw what the CPU rasteriser made for the same camera, stretched, in the place of Gaussians; else as `draw`.

        It stands `PICTURE_SLACK` before the avatars' own meshes, which are not drawn a second time.
        """
        if picture is not self._shown:
            self._shown = picture
            cover = picture.color[..., 3:]
            depth = (picture.depth[..., None] - PICTURE_SLACK) * cover
            moment = np.concatenate([depth, 0.0 * picture.color[..., :2], cover], -1)
            self._small_textures = tuple(_pixels(values[::-1]) for values in (picture.color, moment))
        with _kept_state():
            self._draw_screen(self._small_textures, camera, projection, 0.0, picture)

    def finish(self) -> None:
        """Wait until the graphics card has drawn everything so far, so that times can be measured."""
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")

    def read(self) -> np.ndarray:
        """Return what `draw` blended, premultiplied display RGBA [H, W, 4], top row first; for tests."""
        if self._buffers is None:
            return np.zeros((0, 0, 4), np.float32)
        width, height = self._buffers.size
        with self._buffers.target.bind():
            buffer = gpu.state.active_framebuffer_get()
            values = np.array(buffer.read_color(0, 0, width, height, 4, 0, "FLOAT").to_list(), np.float32)
        return values.reshape(height, width, 4)[::-1]

    def _draw_splats(self, buffers: _Buffers, packed: Packed, camera: Camera, reference: float) -> None:
        view = View.of(camera)
        shader = shaders.splat_shader()
        with buffers.target.bind():
            # Cleared through the bound buffer: both targets at once.
            buffers.target.clear(color=(0.0, 0.0, 0.0, 0.0))
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            gpu.state.blend_set("ALPHA_PREMULT")
            shader.bind()
            _set_rows(shader, camera, packed.origin)
            shader.uniform_float("bounds", tuple(view.clamp))
            shader.uniform_float("lens", (view.fx, view.fy, 0.0, 0.0))
            shader.uniform_float("lens_reference", (view.cx, view.cy, reference, 0.0))
            near = _ORTHO_NEAR if view.orthographic else NEAR
            shader.uniform_float("size_near", (view.width, view.height, near, float(view.orthographic)))
            shader.uniform_sampler("splats", self._splats)
            shader.uniform_sampler("order", self._order)
            self._quad.draw_instanced(shader, instance_count=len(packed))

    def _draw_meshes(self, buffers: _Buffers, camera: Camera, projection: np.ndarray) -> None:
        if self._mesh_batch is None:
            return
        shader = shaders.mesh_shader()
        with buffers.mesh_target.bind():
            gpu.state.depth_test_set("LESS_EQUAL")
            gpu.state.depth_mask_set(True)  # also what clearing depth needs
            buffers.mesh_target.clear(color=(_NOTHING,) * 4, depth=1.0)
            gpu.state.blend_set("NONE")
            shader.bind()
            _set_rows(shader, camera, self._mesh_origin)
            shader.uniform_float("projection", Matrix(projection.tolist()))
            self._mesh_batch.draw(shader)

    def _draw_screen(
        self,
        textures: tuple[gpu.types.GPUTexture, ...],
        camera: Camera,
        projection: np.ndarray,
        reference: float,
        picture: Picture | None = None,
    ) -> None:
        """Put color and moment into the viewport, before meshes if their depth is given; those of a picture stretched."""
        shader = shaders.screen_shader()
        shader.bind()
        terms = projection[2, 2], projection[2, 3], projection[3, 2], projection[3, 3]
        shader.uniform_float("depth_terms", tuple(float(term) for term in terms))
        shader.uniform_float("part", WHOLE if picture is None else picture.part)
        shader.uniform_float("frame", WHOLE if picture is None else picture.frame)
        shader.uniform_bool("stretched", [picture is not None])
        for name, texture in zip(("colors", "moments", "meshes"), (*textures, textures[0]), strict=False):
            shader.uniform_sampler(name, texture)
        gpu.state.blend_set("ALPHA_PREMULT")
        gpu.state.depth_test_set("LESS_EQUAL")
        slack = 0.0
        if self._mesh_batch is not None and picture is None:
            slack = ORTHO_SLACK * camera.width / camera.fx if camera.orthographic else MESH_SLACK
        # Thin cover must not hide what other tools draw behind it, so it writes no depth.
        for low, high, writes in ((SHOWN_COVER, DEPTH_COVER, False), (DEPTH_COVER, 2.0, True)):
            gpu.state.depth_mask_set(writes)
            shader.uniform_float("range", (low, high, reference, slack))
            self._quad.draw(shader)

    def _upload(self, packed: Packed, order: np.ndarray, meshes: tuple[np.ndarray, ...]) -> None:
        if packed is not self._packed:
            self._packed, self._splats = packed, _texture(packed.texels, "RGBA32F")
        if order is not self._ordered:
            self._ordered, self._order = order, _texture(order, "R32F")
        if meshes is not self._meshes:
            self._meshes, self._mesh_batch = meshes, None
            corners = np.concatenate([np.zeros((0, 3, 3)), *meshes]).reshape(-1, 3)
            if len(corners):
                self._mesh_origin = corners.mean(axis=0)
                positions = (corners - self._mesh_origin).astype(np.float32)
                self._mesh_batch = batch_for_shader(shaders.mesh_shader(), "TRIS", {"position": positions})

    def _sized(self, width: int, height: int) -> _Buffers:
        if self._buffers is None or self._buffers.size != (width, height):
            self._buffers = _Buffers((width, height))
        return self._buffers


@contextmanager
def _kept_state() -> Iterator[None]:
    """Blending and depth as they were, afterwards."""
    blend, test, mask = gpu.state.blend_get(), gpu.state.depth_test_get(), gpu.state.depth_mask_get()
    try:
        yield
    finally:
        gpu.state.blend_set(blend)
        gpu.state.depth_test_set(test)
        gpu.state.depth_mask_set(mask)


def _pixels(values: np.ndarray) -> gpu.types.GPUTexture:
    """Return a picture [H, W, 4], bottom row first, as a texture."""
    data = np.ascontiguousarray(values, np.float32)
    height, width, _ = data.shape
    return gpu.types.GPUTexture((width, height), format="RGBA32F", data=gpu.types.Buffer("FLOAT", data.size, data.reshape(-1)))


def _set_rows(shader: gpu.types.GPUShader, camera: Camera, origin: np.ndarray) -> None:
    """Set world to camera for coordinates relative to `origin`."""
    matrix = camera.world_to_camera
    translation = matrix[:3, :3] @ origin + matrix[:3, 3]
    for name, row, shift in zip(("row_x", "row_y", "row_z"), matrix[:3, :3], translation, strict=True):
        shader.uniform_float(name, (*(float(value) for value in row), float(shift)))


def _texture(values: np.ndarray, texture_format: str) -> gpu.types.GPUTexture:
    """Return [rows, TEXTURE_WIDTH] or [rows, TEXTURE_WIDTH, 4] float32 as a texture."""
    data = np.ascontiguousarray(values, np.float32).reshape(-1)  # other types give garbage
    buffer = gpu.types.Buffer("FLOAT", len(data), data)
    return gpu.types.GPUTexture((TEXTURE_WIDTH, values.shape[0]), format=texture_format, data=buffer)
