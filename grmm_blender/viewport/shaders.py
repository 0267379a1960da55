"""The GLSL of the splat viewport, made once for a graphics context.

The projection follows `grmm_core.splat.rules` (EWA as in 3DGS, 0.3 px^2 dilation, cut at a cover of 1/255, and the opacity
compensation of antialiasing where a Gaussian asks for it). Cameras are the core's: x right, y down, z forward, pixels from the
upper left corner.
"""

from __future__ import annotations

import functools

import gpu

from ...grmm_core.splat.rules import ALPHA_MIN, COMPENSATION_MIN, DILATION
from .arrays import PACK_STEPS, TEXELS, TEXTURE_WIDTH

_CONSTANTS = f"""
const int WIDTH = {TEXTURE_WIDTH};
const int TEXELS = {TEXELS};
const float STEPS = {PACK_STEPS}.0;
const float DILATION = {DILATION};
const float COMPENSATION_MIN = {COMPENSATION_MIN!r};
const float ALPHA_MIN = {ALPHA_MIN!r};
"""

_SPLAT_VERTEX = (
    _CONSTANTS
    + """
vec4 texel(int index)
{
  return texelFetch(splats, ivec2(index % WIDTH, index / WIDTH), 0);
}

vec2 unpack_pair(float value)
{
  float high = floor(value / (STEPS + 1.0));
  return vec2(high, value - high * (STEPS + 1.0)) / STEPS;
}

void main()
{
  int place = gl_InstanceID;
  int index = int(texelFetch(order, ivec2(place % WIDTH, place / WIDTH), 0).r + 0.5) * TEXELS;
  vec4 first = texel(index);
  vec4 second = texel(index + 1);
  vec4 third = texel(index + 2);
  vec3 centre = vec3(dot(row_x, vec4(first.xyz, 1.0)), dot(row_y, vec4(first.xyz, 1.0)), dot(row_z, vec4(first.xyz, 1.0)));
  vec2 high = unpack_pair(first.w);
  vec2 low = unpack_pair(third.z);
  float opacity = low.y;

  bool is_ortho = size_near.w > 0.5;
  float z = is_ortho ? 1.0 : centre.z;
  vec2 slope = centre.xy / z;
  vec2 bounded = is_ortho ? vec2(0.0) : clamp(slope, bounds.xz, bounds.yw);
  vec3 along_x = (lens.x / z) * (row_x.xyz - bounded.x * row_z.xyz * (is_ortho ? 0.0 : 1.0));
  vec3 along_y = (lens.y / z) * (row_y.xyz - bounded.y * row_z.xyz * (is_ortho ? 0.0 : 1.0));
  mat3 covariance = mat3(second.x, second.y, second.z, second.y, second.w, third.x, second.z, third.x, third.y);
  vec3 spread_x = covariance * along_x;
  vec3 spread_y = covariance * along_y;
  float a = dot(along_x, spread_x) + DILATION;
  float b = dot(along_x, spread_y);
  float c = dot(along_y, spread_y) + DILATION;
  float det = max(a * c - b * b, DILATION * DILATION);
  if (third.w > 0.5) {
    float area = (a - DILATION) * (c - DILATION) - b * b;
    opacity *= sqrt(clamp(area / det, COMPENSATION_MIN, 1.0));
  }
  float reach = 2.0 * log(max(opacity / ALPHA_MIN, 1e-30));

  if (centre.z < size_near.z || reach <= 0.0) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    offset = vec2(0.0);
    conic = vec3(0.0);
    tint = vec4(0.0);
    away = 0.0;
    return;
  }
  float middle = 0.5 * (a + c);
  float radius = sqrt(max(middle * middle - det, 0.0));
  float major = middle + radius;
  float minor = max(middle - radius, DILATION * 0.5);
  vec2 axis = abs(b) > 1e-9 ? normalize(vec2(b, major - a)) : (a >= c ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
  vec2 reaching = sqrt(reach * vec2(major, minor));
  offset = axis * (corner.x * reaching.x) + vec2(-axis.y, axis.x) * (corner.y * reaching.y);
  conic = vec3(c, -b, a) / det;
  tint = vec4(high, low.x, opacity);
  away = centre.z - lens_reference.z;
  vec2 pixel = lens.xy * slope + lens_reference.xy + offset;
  vec2 place_on_screen = 2.0 * pixel / size_near.xy - 1.0;
  gl_Position = vec4(place_on_screen.x, -place_on_screen.y, 0.0, 1.0);
}
"""
)

_SPLAT_FRAGMENT = (
    _CONSTANTS
    + """
void main()
{
  float power = conic.x * offset.x * offset.x + 2.0 * conic.y * offset.x * offset.y + conic.z * offset.y * offset.y;
  float alpha = min(1.0, tint.a * exp(-0.5 * power));
  if (alpha < ALPHA_MIN) {
    discard;
  }
  color = vec4(tint.rgb * alpha, alpha);
  moment = vec4(away * alpha, 0.0, 0.0, alpha);
}
"""
)

_MESH_VERTEX = """
void main()
{
  vec4 point = vec4(position, 1.0);
  distance_z = dot(row_z, point);
  gl_Position = projection * vec4(dot(row_x, point), -dot(row_y, point), -distance_z, 1.0);
}
"""

_MESH_FRAGMENT = """
void main()
{
  depth = vec4(distance_z);
}
"""

_SCREEN_VERTEX = """
void main()
{
  uv = mix(part.xy, part.zw, 0.5 * corner + 0.5);
  gl_Position = vec4(2.0 * mix(frame.xy, frame.zw, uv) - 1.0, 0.0, 1.0);
}
"""

# One depth for a pixel: the expected one, as in the rasteriser; but in front of the avatar's own mesh, which Blender has drawn.
_SCREEN_FRAGMENT = """
vec3 to_linear(vec3 value)
{
  vec3 c = max(value, vec3(0.0));
  return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(vec3(0.04045), c));
}

vec4 between(sampler2D pixels, vec2 at, ivec2 size)
{
  ivec2 low = ivec2(floor(at));
  vec2 share = at - vec2(low);
  ivec2 last = size - 1;
  vec4 below = mix(texelFetch(pixels, clamp(low, ivec2(0), last), 0),
                   texelFetch(pixels, clamp(low + ivec2(1, 0), ivec2(0), last), 0), share.x);
  vec4 above = mix(texelFetch(pixels, clamp(low + ivec2(0, 1), ivec2(0), last), 0),
                   texelFetch(pixels, clamp(low + ivec2(1, 1), ivec2(0), last), 0), share.x);
  return mix(below, above, share.y);
}

void main()
{
  ivec2 size = textureSize(colors, 0);
  ivec2 place = min(ivec2(uv * vec2(size)), size - 1);
  vec2 at = uv * vec2(size) - 0.5;
  vec4 found = stretched ? between(colors, at, size) : texelFetch(colors, place, 0);
  if (found.a < range.x || found.a >= range.y) {
    discard;
  }
  vec4 moment = stretched ? between(moments, at, size) : texelFetch(moments, place, 0);
  float z = range.z + moment.r / found.a;
  if (range.w > 0.0) {
    // Under perspective a share of the distance, else metres.
    bool is_ortho = depth_terms.z == 0.0;
    for (int x = -1; x <= 1; x++) {
      for (int y = -1; y <= 1; y++) {
        ivec2 near = clamp(place + ivec2(x, y), ivec2(0), size - 1);
        float mesh = texelFetch(meshes, near, 0).r;
        z = min(z, mesh - range.w * (is_ortho ? 1.0 : mesh));
      }
    }
  }
  float w = depth_terms.z * -z + depth_terms.w;
  gl_FragDepth = clamp(0.5 * (depth_terms.x * -z + depth_terms.y) / w + 0.5, 0.0, 1.0);
  color = srgbTarget ? vec4(to_linear(found.rgb), found.a) : found;
}
"""


@functools.cache
def splat_shader() -> gpu.types.GPUShader:
    """Draws sorted Gaussians into two buffers: premultiplied display colors, and depth from the reference times cover."""
    info = _info(
        ("VEC4", "row_x"),  # world to camera, with the translation; x / z only matters under perspective
        ("VEC4", "row_y"),
        ("VEC4", "row_z"),
        ("VEC4", "bounds"),  # lowest and highest x / z, then y / z
        ("VEC4", "lens"),  # fx, fy
        ("VEC4", "lens_reference"),  # cx, cy, reference depth
        ("VEC4", "size_near"),  # width, height, nearest depth, 1 for orthographic
    )
    info.sampler(0, "FLOAT_2D", "splats")
    info.sampler(1, "FLOAT_2D", "order")
    info.vertex_in(0, "VEC2", "corner")
    passed = gpu.types.GPUStageInterfaceInfo("grmm_splat")
    passed.smooth("VEC2", "offset")
    passed.flat("VEC3", "conic")
    passed.flat("VEC4", "tint")
    passed.flat("FLOAT", "away")
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "color")
    info.fragment_out(1, "VEC4", "moment")
    return _create(info, _SPLAT_VERTEX, _SPLAT_FRAGMENT)


@functools.cache
def mesh_shader() -> gpu.types.GPUShader:
    """Draws the camera depth of triangles."""
    info = _info(("MAT4", "projection"), ("VEC4", "row_x"), ("VEC4", "row_y"), ("VEC4", "row_z"))
    info.vertex_in(0, "VEC3", "position")
    passed = gpu.types.GPUStageInterfaceInfo("grmm_mesh")
    passed.smooth("FLOAT", "distance_z")
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "depth")
    return _create(info, _MESH_VERTEX, _MESH_FRAGMENT)


@functools.cache
def screen_shader() -> gpu.types.GPUShader:
    """Puts the finished picture into the viewport, with depth."""
    info = _info(
        ("VEC4", "depth_terms"),  # of the projection matrix: [2][2], [2][3], [3][2], [3][3]
        ("VEC4", "range"),  # lowest and highest cover that is drawn, reference depth, slack (0: none)
        ("VEC4", "part"),  # of the picture that is drawn: lower left and upper right corner, 0 to 1
        ("VEC4", "frame"),  # the picture's part of the viewport, likewise
        ("BOOL", "stretched"),  # the picture is smaller than the viewport
        ("BOOL", "srgbTarget"),  # set by Blender: whether the viewport's buffer turns linear values into sRGB
    )
    info.sampler(0, "FLOAT_2D", "colors")
    info.sampler(1, "FLOAT_2D", "moments")
    info.sampler(2, "FLOAT_2D", "meshes")
    info.vertex_in(0, "VEC2", "corner")
    passed = gpu.types.GPUStageInterfaceInfo("grmm_screen")
    passed.smooth("VEC2", "uv")
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "color")
    info.depth_write("ANY")
    return _create(info, _SCREEN_VERTEX, _SCREEN_FRAGMENT)


def forget() -> None:
    """Drop the shaders; called when the extension is unregistered."""
    for shader in (splat_shader, mesh_shader, screen_shader):
        shader.cache_clear()


def _info(*constants: tuple[str, str]) -> gpu.types.GPUShaderCreateInfo:
    info = gpu.types.GPUShaderCreateInfo()
    for kind, name in constants:
        info.push_constant(kind, name)
    return info


def _create(info: gpu.types.GPUShaderCreateInfo, vertex: str, fragment: str) -> gpu.types.GPUShader:
    info.vertex_source(vertex)
    info.fragment_source(fragment)
    return gpu.shader.create_from_info(info)
