// Gradients of colours of spherical harmonics of degree 0 to 4, see harmonics.glsl.

// Maximum gradient of a basis function passed to the view direction, as the CPU's.
#define GS_SLOPE_MAX 1e30

// Basis functions from number 4 `group` on; 0 beyond the degree.
vec4 harmonics_of(uint group, vec3 d) {
    const float c2[5] = float[5](GS_SH_C2);
    const float c3[7] = float[7](GS_SH_C3);
    const float c4[9] = float[9](GS_SH_C4);
    int degree = frame.view.sh_degree;
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    float rr = xx + yy, p = 4.0 * zz - 3.0 * rr, q = 6.0 * zz - rr, e = xx - yy;
    vec4 b = vec4(0.0);
    if (group == 0) {
        b = vec4(GS_SH_C0, -GS_SH_C1 * y, GS_SH_C1 * z, -GS_SH_C1 * x);
        if (degree < 1)
            b.yzw = vec3(0.0);
    } else if (group == 1) {
        if (degree >= 2)
            b = vec4(c2[0] * (x * y), c2[1] * (y * z), c2[2] * (2.0 * zz - xx - yy), c2[3] * (x * z));
    } else if (group == 2) {
        if (degree >= 2)
            b.x = c2[4] * (xx - yy);
        if (degree >= 3)
            b.yzw = vec3(c3[0] * y * (3.0 * xx - yy), c3[1] * (x * y) * z, c3[2] * y * (4.0 * zz - xx - yy));
    } else if (group == 3) {
        if (degree >= 3)
            b = vec4(c3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), c3[4] * x * (4.0 * zz - xx - yy), c3[5] * z * (xx - yy),
                     c3[6] * x * (xx - 3.0 * yy));
    } else if (degree >= 4) {
        if (group == 4)
            b = vec4(c4[0] * (x * y) * e, c4[1] * (y * z) * (3.0 * xx - yy), c4[2] * (x * y) * q, c4[3] * (y * z) * p);
        if (group == 5)
            b = vec4(c4[4] * (8.0 * zz * (zz - 3.0 * rr) + 3.0 * rr * rr), c4[5] * (x * z) * p, c4[6] * e * q,
                     c4[7] * (x * z) * (xx - 3.0 * yy));
        if (group == 6)
            b.x = c4[8] * (xx * (xx - 6.0 * yy) + yy * yy);
    }
    return b;
}

// Coefficients close to overflow do not affect a colour where their basis function is zero, but its slope: such a slope
// is dropped.
float kept_slope(float s) { return finite(s) && abs(s) <= GS_SLOPE_MAX ? s : 0.0; }

// Dot products of four coefficients, from number 4 `group` on, with the gradient of the colour.
vec4 four_slopes(uint row, uint group, vec3 v) {
    vec4 p = harmonic_plane(row, 3 * group), q = harmonic_plane(row, 3 * group + 1), r = harmonic_plane(row, 3 * group + 2);
    vec4 s = vec4(sum3(p.xyz, v), sum3(vec3(p.w, q.xy), v), sum3(vec3(q.zw, r.x), v), sum3(r.yzw, v));
    for (int k = 0; k < 4; ++k)
        s[k] = kept_slope(s[k]);
    return s;
}

// Gradient of the unit direction d through the functions of degree 4.
vec3 direction_backward_4(uint row, vec3 d, vec3 v_color) {
    const float c4[9] = float[9](GS_SH_C4);
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    float rr = xx + yy, p = 4.0 * zz - 3.0 * rr, q = 6.0 * zz - rr, e = xx - yy;
    vec4 s = four_slopes(row, 4, v_color);
    float a0 = c4[0] * s.x, a1 = c4[1] * s.y, a2 = c4[2] * s.z, a3 = c4[3] * s.w;
    s = four_slopes(row, 5, v_color);
    float a4 = c4[4] * s.x, a5 = c4[5] * s.y, a6 = c4[6] * s.z, a7 = c4[7] * s.w;
    float a8 = c4[8] * kept_slope(sum3(harmonic_plane(row, 18).xyz, v_color));
    float a = 12.0 * a4 * (rr - 4.0 * zz), b = 6.0 * x * y * z;
    return vec3(a0 * y * (3.0 * xx - yy) + a1 * b + a2 * y * (q - 2.0 * xx) - a3 * b + a * x + a5 * z * (p - 6.0 * xx) +
                    2.0 * a6 * x * (q - e) + 3.0 * a7 * z * e + 4.0 * a8 * x * (xx - 3.0 * yy),
                a0 * x * (xx - 3.0 * yy) + 3.0 * a1 * z * e + a2 * x * (q - 2.0 * yy) + a3 * z * (p - 6.0 * yy) + a * y -
                    a5 * b - 2.0 * a6 * y * (q + e) - a7 * b + 4.0 * a8 * y * (yy - 3.0 * xx),
                a1 * y * (3.0 * xx - yy) + 2.0 * a2 * b + a3 * y * (p + 8.0 * zz) + 16.0 * a4 * z * (2.0 * zz - 3.0 * rr) +
                    a5 * x * (p + 8.0 * zz) + 12.0 * a6 * e * z + a7 * x * (xx - 3.0 * yy));
}

// Gradient of the unit direction d, given that of the colour.
vec3 direction_backward(uint row, vec3 d, vec3 v_color) {
    const float c2[5] = float[5](GS_SH_C2);
    const float c3[7] = float[7](GS_SH_C3);
    int degree = frame.view.sh_degree;
    float x = d.x, y = d.y, z = d.z;
    vec3 v = vec3(0.0);
    if (degree < 1)
        return v;
    vec4 s = four_slopes(row, 0, v_color);
    v = vec3(-GS_SH_C1 * s.w, -GS_SH_C1 * s.y, GS_SH_C1 * s.z);
    if (degree < 2)
        return v;
    s = four_slopes(row, 1, v_color);
    // The last function of degree 2 has the planes of the next group; where that is not stored, its first plane is.
    float last2 = kept_slope(sum3(harmonic_plane(row, 6).xyz, v_color));
    float a4 = c2[0] * s.x, a5 = c2[1] * s.y, a6 = c2[2] * s.z, a7 = c2[3] * s.w, a8 = c2[4] * last2;
    v += vec3(a4 * y - 2.0 * a6 * x + a7 * z + 2.0 * a8 * x, a4 * x + a5 * z - 2.0 * a6 * y - 2.0 * a8 * y,
              a5 * y + 4.0 * a6 * z + a7 * x);
    if (degree < 3)
        return v;
    float xx = x * x, yy = y * y, zz = z * z;
    s = four_slopes(row, 2, v_color);
    float c9 = c3[0] * s.y, c10 = c3[1] * s.z, c11 = c3[2] * s.w;
    s = four_slopes(row, 3, v_color);
    float c12 = c3[3] * s.x, c13 = c3[4] * s.y, c14 = c3[5] * s.z, c15 = c3[6] * s.w;
    v += vec3(6.0 * c9 * x * y + c10 * y * z - 2.0 * c11 * x * y - 6.0 * c12 * x * z + c13 * (4.0 * zz - 3.0 * xx - yy) +
                  2.0 * c14 * x * z + 3.0 * c15 * (xx - yy),
              3.0 * c9 * (xx - yy) + c10 * x * z + c11 * (4.0 * zz - xx - 3.0 * yy) - 6.0 * c12 * y * z - 2.0 * c13 * x * y -
                  2.0 * c14 * y * z - 6.0 * c15 * x * y,
              c10 * x * y + 8.0 * c11 * y * z + c12 * (6.0 * zz - 3.0 * xx - 3.0 * yy) + 8.0 * c13 * x * z + c14 * (xx - yy));
    return degree < 4 ? v : v + direction_backward_4(row, d, v_color);
}
