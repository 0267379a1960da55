"""Takes out of a rendered viewport what Blender's overlays draw behind avatars: outlines of their meshes, bones, the grid.

Blender keeps overlays in a picture of their own, over the engine's and with the depth of meshes only, so that they would be
seen through hair. Main thread only.
"""

from __future__ import annotations

import functools

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

SLACK = 0.02  # metres in front of an avatar's surface within which overlays are taken out too: its own mesh lies there
COVER = 0.5  # from this cover on, avatars hide what is behind them

_VERTEX = """
void main()
{
  uv = 0.5 * corner + 0.5;
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""

_FRAGMENT = """
void main()
{
  vec2 found = texture(avatars, uv).rg;
  if (found.x < limits.x) {
    discard;
  }
  float z = found.y - limits.y;
  float w = depth_terms.z * -z + depth_terms.w;
  gl_FragDepth = clamp(0.5 * (depth_terms.x * -z + depth_terms.y) / w + 0.5, 0.0, 1.0);
  color = vec4(0.0);
}
"""


def hide_overlays(avatars: gpu.types.GPUTexture, projection: np.ndarray, nearer: float) -> None:
    """Clear the buffer that is bound where avatars are nearer than what it shows.

    Args:
        avatars: Visible cover of the avatars and their depth in metres, a texture of two channels.
        projection: OpenGL projection matrix of the viewport, [4, 4].
        nearer: How much nearer the viewport's camera is than the one whose depth is given, metres.
    """
    shader, quad = _shader(), _quad()
    shader.bind()
    terms = projection[2, 2], projection[2, 3], projection[3, 2], projection[3, 3]
    shader.uniform_float("depth_terms", tuple(float(term) for term in terms))
    shader.uniform_float("limits", (COVER, nearer + SLACK))
    shader.uniform_sampler("avatars", avatars)
    gpu.state.blend_set("NONE")
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("LESS_EQUAL")
    quad.draw(shader)
    gpu.state.depth_test_set("NONE")


def forget() -> None:
    """Drop the shader; called when the engine is unregistered."""
    _shader.cache_clear()
    _quad.cache_clear()


@functools.cache
def _shader() -> gpu.types.GPUShader:
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("VEC4", "depth_terms")  # of the projection matrix: [2][2], [2][3], [3][2], [3][3]
    info.push_constant("VEC2", "limits")  # least cover, metres to take off the depth
    info.sampler(0, "FLOAT_2D", "avatars")
    info.vertex_in(0, "VEC2", "corner")
    passed = gpu.types.GPUStageInterfaceInfo("grmm_overlays")
    passed.smooth("VEC2", "uv")
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "color")
    info.depth_write("ANY")
    info.vertex_source(_VERTEX)
    info.fragment_source(_FRAGMENT)
    return gpu.shader.create_from_info(info)


@functools.cache
def _quad() -> gpu.types.GPUBatch:
    corners = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]], np.float32)
    return batch_for_shader(_shader(), "TRI_STRIP", {"corner": corners})
