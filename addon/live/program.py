"""Shader programs: splats to their picture, that picture to the view, and updates of atlas rows.

The formulas are those of docs/conventions.md. The atlas has the view-independent data of splats,
the order has their colours in this view; the CPU computes both.
"""

import gpu

from ..compat import declare_depth
from ..core import glsl_defines
from .atlas import COLUMNS, TEXELS
from .clip import PLANES

QUADS = 64
"""Splats per instance."""
ORDER_COLUMNS = 1024
"""Splats in a row of the order texture."""

_SPLAT_VERTEX = """
void main()
{
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside: not drawn
  ellipse = vec4(0.0);
  shade = vec4(0.0);
  spot = vec3(0.0, 0.0, 2.0);
  int number = int(corner.z + 0.5) + gl_InstanceID * QUADS;
  if (number >= int(count.x)) {
    return;
  }
  vec4 entry = texelFetch(sorted, ivec2(number % ORDER_COLUMNS, number / ORDER_COLUMNS), 0);
  int row = int(entry.x);  // an integer; adding 0.5 would round wrongly from 2^23 on
  if (row >= int(count.y)) {
    return;
  }
  ivec2 at = ivec2((row % COLUMNS) * TEXELS, row / COLUMNS);
  vec4 a = texelFetch(atlas, at, 0);
  vec4 b = texelFetch(atlas, at + ivec2(1, 0), 0);
  vec4 c = texelFetch(atlas, at + ivec2(2, 0), 0);
  int from = int(c.z + 0.5) * 3;
  vec4 r0 = texelFetch(places, ivec2(from, 0), 0);
  vec4 r1 = texelFetch(places, ivec2(from + 1, 0), 0);
  vec4 r2 = texelFetch(places, ivec2(from + 2, 0), 0);
  vec4 mean = vec4(a.xyz, 1.0);
  vec3 p = vec3(dot(r0, mean), dot(r1, mean), dot(r2, mean));
  if (p.z < frame.z) {
    return;
  }
  float clip = projection.y - projection.x * p.z;
  float depth = 0.5 + 0.5 * (projection.z > 0.5 ? clip / p.z : clip);
  int cuts = int(count.w + 0.5);
  if (cuts % 2 == 1 && depth > 1.0) {
    return;
  }
  if (cuts >= 2) {
    int first = textureSize(places, 0).x - PLANES;
    for (int k = 0; k < PLANES; k++) {
      if (dot(texelFetch(places, ivec2(first + k, 0), 0), vec4(p, 1.0)) < 0.0) {
        return;
      }
    }
  }
  vec2 f = lens.xy, middle = lens.zw, size = frame.xy;
  vec3 m0, m1;
  vec2 at_pixel;
  if (frame.w > 0.5) {  // parallel rays
    m0 = f.x * r0.xyz;
    m1 = f.y * r1.xyz;
    at_pixel = f * p.xy + middle;
  }
  else {
    vec2 margin = 0.5 * GS_JACOBIAN_MARGIN * size / f;
    vec2 slope = clamp(p.xy / p.z, -(middle / f + margin), (size - middle) / f + margin);
    m0 = (r0.xyz - slope.x * r2.xyz) * (f.x / p.z);
    m1 = (r1.xyz - slope.y * r2.xyz) * (f.y / p.z);
    at_pixel = f * p.xy / p.z + middle;
  }
  vec3 s0 = vec3(b.x, b.y, b.z), s1 = vec3(b.y, b.w, c.x), s2 = vec3(b.z, c.x, c.y);
  vec3 v0 = vec3(dot(s0, m0), dot(s1, m0), dot(s2, m0));
  vec3 v1 = vec3(dot(s0, m1), dot(s1, m1), dot(s2, m1));
  float xx = max(dot(m0, v0), 0.0), yy = max(dot(m1, v1), 0.0), xy = dot(m1, v0);
  float before = max(xx * yy - xy * xy, 0.0);
  float after = before + GS_EPS2D * (xx + yy + GS_EPS2D);
  xx += GS_EPS2D;
  yy += GS_EPS2D;
  float opacity = a.w;
  if (projection.w > 0.5) {
    opacity *= max(sqrt(before / after), GS_COMPENSATION_MIN);
  }
  if (opacity < GS_ALPHA_MIN) {
    return;
  }
  float half_trace = 0.5 * (xx + yy);
  float apart = sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy);
  vec2 axis = vec2(1.0, 0.0);
  if (apart > 1e-6 * half_trace) {
    axis = xx > yy ? vec2(0.5 * (xx - yy) + apart, xy) : vec2(xy, 0.5 * (yy - xx) + apart);
    axis = normalize(axis);
  }
  float reach = sqrt(2.0 * log(opacity / GS_ALPHA_MIN));
  float longest = half_trace + apart;
  vec2 radii = sqrt(vec2(longest, max(after / longest, GS_EPS2D)));
  vec2 other = vec2(-axis.y, axis.x);
  ellipse = vec4(axis / radii.x, other / radii.y);
  spot = vec3(at_pixel, depth);
  shade = vec4(entry.yzw, opacity);
  vec2 to = corner.xy * (reach * radii + 0.01);  // the card rounds corners
  at_pixel += axis * to.x + other * to.y;
  gl_Position = vec4(2.0 * at_pixel.x / size.x - 1.0, 1.0 - 2.0 * at_pixel.y / size.y, 0.0, 1.0);
}
"""
_SPLAT_FRAGMENT = """
void main()
{
  // From the pixel's middle: values interpolated from the corners have their rounding errors.
  vec2 from = vec2(gl_FragCoord.x, frame.y - gl_FragCoord.y) - spot.xy;
  vec2 spread = vec2(dot(from, ellipse.xy), dot(from, ellipse.zw));
  float alpha = min(GS_ALPHA_MAX, shade.a * exp(-0.5 * dot(spread, spread)));
  if (alpha < GS_ALPHA_MIN) {
    discard;
  }
  if (count.z > 0.5) {
    vec2 scale = vec2(textureSize(meshes, 0)) / frame.xy;
    if (spot.z > texelFetch(meshes, ivec2(gl_FragCoord.xy * scale), 0).r) {
      discard;
    }
  }
  result = vec4(shade.rgb * alpha, alpha);
#ifdef NEARNESS
  // From the far end, where a view's depths crowd: float precision is highest near 0.
  nearness = vec4((1.0 - spot.z) * alpha, 0.0, 0.0, alpha);
#endif
}
"""
_SCREEN_VERTEX = """
void main()
{
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""
_VIEW_FRAGMENT = """
vec4 between(sampler2D from, ivec2 p0, ivec2 p1, vec2 part)
{
  vec4 below = mix(texelFetch(from, p0, 0), texelFetch(from, ivec2(p1.x, p0.y), 0), part.x);
  vec4 above = mix(texelFetch(from, ivec2(p0.x, p1.y), 0), texelFetch(from, p1, 0), part.x);
  return mix(below, above, part.y);
}

void main()
{
  vec2 at = (gl_FragCoord.xy - place.xy) * place.zw, part = vec2(0.0);
  ivec2 p0 = ivec2(at), p1 = p0;
  if (place.z != 1.0) {  // a smaller picture, interpolated
    at -= 0.5;
    ivec2 low = ivec2(floor(at)), most = textureSize(picture, 0) - 1;
    part = at - vec2(low);
    p0 = clamp(low, ivec2(0), most);
    p1 = clamp(low + 1, ivec2(0), most);
  }
  vec4 found = between(picture, p0, p1, part);
  if (found.a <= 0.0) {
    discard;
  }
#ifdef NEARNESS
  gl_FragDepth = clamp(1.0 - between(nearness, p0, p1, part).r / found.a, 0.0, 1.0);
#endif
  // The view stores overlays as light, and encodes them with exponent 2.2.
  vec3 value = clamp(found.rgb / found.a, 0.0, 1.0);
  if (layer > 1.5) {  // factor that removes covered overlays
    result = vec4(1.0 - found.a);
    return;
  }
  if (layer > 0.5) {  // for the view's own picture, linear light
    vec3 low = value / 12.92, high = pow((value + 0.055) / 1.055, vec3(2.4));
    result = vec4(mix(high, low, vec3(lessThanEqual(value, vec3(0.04045)))) * found.a, found.a);
    return;
  }
  vec3 light = pow(value, vec3(2.2));
  // A photo in front was drawn before the splats: it is blended over them too, so that it stays the
  // same where there are none.
  vec2 of_photo = (gl_FragCoord.xy - place.xy - photo_frame.xy) / photo_frame.zw;
  if (photo_opacity > 0.0 && of_photo == clamp(of_photo, 0.0, 1.0)) {
    vec4 over = texture(photo, of_photo) * photo_opacity;
    light = light * (1.0 - over.a) + over.rgb;
  }
  result = vec4(light * found.a, found.a);
}
"""
_ROWS_FRAGMENT = """
void main()
{
  result = texelFetch(piece, ivec2(gl_FragCoord.xy - vec2(0.0, row)), 0);
}
"""


def splats(*, nearness: bool = False) -> gpu.types.GPUShader:
    """Shader that draws splats as quads, farthest first.

    Args:
        nearness: Write 1 - depth to a second picture, blended like colours.

    Raises:
        Exception: the driver cannot compile it.
    """
    info = gpu.types.GPUShaderCreateInfo()
    info.define("QUADS", str(QUADS))
    info.define("ORDER_COLUMNS", str(ORDER_COLUMNS))
    info.define("COLUMNS", str(COLUMNS))
    info.define("TEXELS", str(TEXELS))
    info.define("PLANES", str(PLANES))
    info.push_constant("VEC4", "lens")  # fx, fy, cx, cy, pixels
    info.push_constant("VEC4", "frame")  # width, height, near, whether rays are parallel
    info.push_constant("VEC4", "projection")  # depth's factor, offset, by z?, antialias?
    # Entries of the order, rows to draw, meshes?, clipping: 1 the far end, 2 planes, 3 both.
    info.push_constant("VEC4", "count")
    for slot, name in enumerate(("atlas", "sorted", "places", "meshes")):
        info.sampler(slot, "FLOAT_2D", name)
    info.vertex_in(0, "VEC3", "corner")
    between = gpu.types.GPUStageInterfaceInfo("gscore_splats")
    between.flat("VEC4", "ellipse")  # its unit axes, each divided by its standard deviation
    between.flat("VEC3", "spot")  # center, pixels from the upper left; depth
    between.flat("VEC4", "shade")
    info.vertex_out(between)
    if nearness:
        info.define("NEARNESS")
        info.fragment_out(1, "VEC4", "nearness")
    return _made(info, _SPLAT_VERTEX, _SPLAT_FRAGMENT)


def view(*, nearness: bool = False) -> gpu.types.GPUShader:
    """Shader that draws the picture over the view.

    Args:
        nearness: Write the depth of each pixel, from the second picture of `splats`.

    Raises:
        Exception: the driver cannot compile it.
    """
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("VEC4", "place")  # left, bottom, pixels of the picture per pixel of the view
    info.push_constant("VEC4", "photo_frame")  # left, bottom, width, height, pixels of the view
    info.push_constant("FLOAT", "photo_opacity")
    info.push_constant("FLOAT", "layer")  # 0 overlay, 1 own picture, 2 remove covered overlays
    info.sampler(0, "FLOAT_2D", "picture")
    info.sampler(1, "FLOAT_2D", "photo")
    if nearness:
        info.define("NEARNESS")
        info.sampler(2, "FLOAT_2D", "nearness")
        declare_depth(info)
    info.vertex_in(0, "VEC2", "corner")
    return _made(info, _SCREEN_VERTEX, _VIEW_FRAGMENT)


def rows() -> gpu.types.GPUShader:
    """Shader that copies a texture to rows of another.

    Raises:
        Exception: the driver cannot compile it.
    """
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("FLOAT", "row")  # first row to write
    info.sampler(0, "FLOAT_2D", "piece")
    info.vertex_in(0, "VEC2", "corner")
    return _made(info, _SCREEN_VERTEX, _ROWS_FRAGMENT)


def _made(info: gpu.types.GPUShaderCreateInfo, vertex: str, fragment: str) -> gpu.types.GPUShader:
    for name, value in glsl_defines(vertex + fragment).items():
        info.define(name, value)
    info.fragment_out(0, "VEC4", "result")
    info.vertex_source(vertex)
    info.fragment_source(fragment)
    return gpu.shader.create_from_info(info)
