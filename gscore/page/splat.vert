#version 300 es
// A splat as its bounding rectangle, by the formulas of docs/conventions.md.
precision highp float;
precision highp int;
precision highp usampler2D;

uniform usampler2D splats;
uniform int texels, degree;
uniform float turns, restStep, nearest;
uniform bool compensated;
uniform mat3 colorAxes; // columns: grey and two differences
uniform mat3 rotation;  // world to camera
uniform vec3 position;  // of the camera
uniform vec4 lens;      // fx, fy, cx, cy, px
uniform vec2 size;      // of the picture, px

layout(location = 0) in uint index;
out vec2 place;      // in standard deviations of the splat
flat out vec4 shade; // colour and opacity

uvec4 texel(int k) {
    int at = int(index) * texels + k;
    return texelFetch(splats, ivec2(at & 2047, at >> 11), 0);
}

mat3 turned(uint packed) {
    vec3 three = (vec3(uvec3(packed >> 8, packed >> 16, packed >> 24) & 255u) / (turns - 1.0) - 0.5) * sqrt(2.0);
    float rest = sqrt(max(1.0 - dot(three, three), 0.0));
    uint largest = packed & 3u;
    vec4 q = largest == 0u   ? vec4(rest, three)
             : largest == 1u ? vec4(three.x, rest, three.yz)
             : largest == 2u ? vec4(three.xy, rest, three.z)
                             : vec4(three, rest);
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// Basis functions beyond the constant, bands ascending, within a band m = -l..l; signs of 3DGS.
void basis(vec3 d, out float b[15]) {
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    const float c2[5] = float[5](GS_SH_C2), c3[7] = float[7](GS_SH_C3);
    b[0] = -GS_SH_C1 * y;
    b[1] = GS_SH_C1 * z;
    b[2] = -GS_SH_C1 * x;
    b[3] = c2[0] * x * y;
    b[4] = c2[1] * y * z;
    b[5] = c2[2] * (2.0 * zz - xx - yy);
    b[6] = c2[3] * x * z;
    b[7] = c2[4] * (xx - yy);
    b[8] = c3[0] * y * (3.0 * xx - yy);
    b[9] = c3[1] * x * y * z;
    b[10] = c3[2] * y * (4.0 * zz - xx - yy);
    b[11] = c3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    b[12] = c3[4] * x * (4.0 * zz - xx - yy);
    b[13] = c3[5] * z * (xx - yy);
    b[14] = c3[6] * x * (xx - 3.0 * yy);
}

// View-dependent part of the colour.
vec3 seen(vec3 direction) {
    float b[15];
    basis(direction, b);
    int count = 3 * ((degree + 1) * (degree + 1) - 1);
    vec3 sum = vec3(0.0);
    uvec4 words = uvec4(0u);
    for (int k = 0; k < count; ++k) {
        if ((k & 15) == 0)
            words = texel(2 + (k >> 4));
        int whole = int(words[(k >> 2) & 3] << (24 - 8 * (k & 3))) >> 24;
        sum[k % 3] += b[k / 3] * float(whole);
    }
    return colorAxes * sum * restStep;
}

void main() {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside: not drawn
    uvec4 first = texel(0), second = texel(1);
    vec3 away = uintBitsToFloat(first.xyz) - position;
    vec3 seat = rotation * away;
    if (!(seat.z > nearest))
        return;

    vec2 reach = 0.5 * GS_JACOBIAN_MARGIN * size / lens.xy;
    vec2 ratio = clamp(seat.xy / seat.z, -lens.zw / lens.xy - reach, (size - lens.zw) / lens.xy + reach);
    vec2 sizes = unpackHalf2x16(second.x), more = unpackHalf2x16(second.y);
    mat3 shape = rotation * turned(first.w);
    vec3 scale = exp(vec3(sizes, more.x));
    vec3 deep = vec3(shape[0].z, shape[1].z, shape[2].z);
    vec3 mx = lens.x / seat.z * (vec3(shape[0].x, shape[1].x, shape[2].x) - ratio.x * deep) * scale;
    vec3 my = lens.y / seat.z * (vec3(shape[0].y, shape[1].y, shape[2].y) - ratio.y * deep) * scale;
    vec3 minors = cross(mx, my);
    float xx = dot(mx, mx) + GS_EPS2D, yy = dot(my, my) + GS_EPS2D, xy = dot(mx, my);
    float det0 = dot(minors, minors), det = det0 + GS_EPS2D * (xx + yy - GS_EPS2D);
    float opacity = more.y;
    if (compensated)
        opacity *= max(sqrt(det0 / det), GS_COMPENSATION_MIN);
    if (!(opacity >= GS_ALPHA_MIN && det > 0.0 && det < 3e38))
        return;

    float half_ = 0.5 * (xx - yy), root = sqrt(half_ * half_ + xy * xy);
    float longer = 0.5 * (xx + yy) + root;
    vec2 along = half_ > 0.0 ? vec2(half_ + root, xy) : vec2(xy, root - half_);
    along = root > 0.0 ? normalize(along) : vec2(1.0, 0.0);
    float edge = sqrt(2.0 * log(opacity / GS_ALPHA_MIN));
    place = (vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0) * edge;
    vec2 offset = place.x * sqrt(longer) * along + place.y * sqrt(det / longer) * vec2(-along.y, along.x);
    vec2 at = (lens.xy * seat.xy / seat.z + lens.zw + offset) / size;
    gl_Position = vec4(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.0, 1.0);
    vec3 color = vec3(unpackHalf2x16(second.z), unpackHalf2x16(second.w).x);
    shade = vec4(max(color + seen(normalize(away)), 0.0), opacity);
}
