// Gradients of colours of spherical harmonics of degree 0 to 3, see harmonics.glsl.

// Maximum gradient of a basis function passed to the view direction, as the CPU's.
#define GS_SLOPE_MAX 1e30

// Basis functions from number 4 `group` on; 0 beyond the degree.
vec4 harmonics_of(uint group, vec3 d) {
    const float c2[5] = float[5](GS_SH_C2);
    const float c3[7] = float[7](GS_SH_C3);
    int degree = frame.view.sh_degree;
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
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
    } else if (degree >= 3) {
        b = vec4(c3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), c3[4] * x * (4.0 * zz - xx - yy), c3[5] * z * (xx - yy),
                 c3[6] * x * (xx - 3.0 * yy));
    }
    return b;
}

// Dot products of four coefficients, from number 4 `group` on, with the gradient of the colour.
vec4 four_slopes(uint row, uint group, vec3 v) {
    vec4 p = harmonic_plane(row, 3 * group), q = harmonic_plane(row, 3 * group + 1), r = harmonic_plane(row, 3 * group + 2);
    vec4 s = vec4(sum3(p.xyz, v), sum3(vec3(p.w, q.xy), v), sum3(vec3(q.zw, r.x), v), sum3(r.yzw, v));
    // Coefficients close to overflow do not affect a colour where their basis function is zero, but its slope: such a
    // slope is dropped.
    for (int k = 0; k < 4; ++k)
        s[k] = finite(s[k]) && abs(s[k]) <= GS_SLOPE_MAX ? s[k] : 0.0;
    return s;
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
    float last2 = sum3(harmonic_plane(row, 6).xyz, v_color);
    last2 = finite(last2) && abs(last2) <= GS_SLOPE_MAX ? last2 : 0.0;
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
    return v;
}
