// Colours of spherical harmonics of degree 0 to 4. Signs and order are those of 3D Gaussian Splatting: bands in ascending
// order, within a band m = -l..l.

vec4 harmonic_plane(uint row, uint plane) { return frame.model.at[(GS_PLANE_SH + plane) * frame.count + row]; }

// Sum of four coefficients, from number 4 `group` on, with their basis functions.
vec3 four_harmonics(uint row, uint group, vec4 b) {
    vec4 p = harmonic_plane(row, 3 * group), q = harmonic_plane(row, 3 * group + 1), r = harmonic_plane(row, 3 * group + 2);
    return p.xyz * b.x + vec3(p.w, q.xy) * b.y + vec3(q.zw, r.x) * b.z + r.yzw * b.w;
}

// Colour of a row seen along a unit direction, not clamped.
vec3 color_of(uint row, vec3 d) {
    const float c2[5] = float[5](GS_SH_C2);
    const float c3[7] = float[7](GS_SH_C3);
    const float c4[9] = float[9](GS_SH_C4);
    int degree = frame.view.sh_degree;
    float x = d.x, y = d.y, z = d.z;
    if (degree < 1)
        return 0.5 + harmonic_plane(row, 0).xyz * GS_SH_C0;
    vec3 color = 0.5 + four_harmonics(row, 0, vec4(GS_SH_C0, -GS_SH_C1 * y, GS_SH_C1 * z, -GS_SH_C1 * x));
    if (degree < 2)
        return color;
    float xx = x * x, yy = y * y, zz = z * z;
    color += four_harmonics(row, 1, vec4(c2[0] * (x * y), c2[1] * (y * z), c2[2] * (2.0 * zz - xx - yy), c2[3] * (x * z)));
    float last2 = c2[4] * (xx - yy);
    if (degree < 3)
        return color + harmonic_plane(row, 6).xyz * last2;
    color += four_harmonics(row, 2, vec4(last2, c3[0] * y * (3.0 * xx - yy), c3[1] * (x * y) * z,
                                         c3[2] * y * (4.0 * zz - xx - yy)));
    color += four_harmonics(row, 3, vec4(c3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), c3[4] * x * (4.0 * zz - xx - yy),
                                         c3[5] * z * (xx - yy), c3[6] * x * (xx - 3.0 * yy)));
    if (degree < 4)
        return color;
    float rr = xx + yy, p = 4.0 * zz - 3.0 * rr, q = 6.0 * zz - rr, e = xx - yy;
    color += four_harmonics(row, 4, vec4(c4[0] * (x * y) * e, c4[1] * (y * z) * (3.0 * xx - yy), c4[2] * (x * y) * q,
                                         c4[3] * (y * z) * p));
    color += four_harmonics(row, 5, vec4(c4[4] * (8.0 * zz * (zz - 3.0 * rr) + 3.0 * rr * rr), c4[5] * (x * z) * p,
                                         c4[6] * e * q, c4[7] * (x * z) * (xx - 3.0 * yy)));
    return color + harmonic_plane(row, 18).xyz * (c4[8] * (xx * (xx - 6.0 * yy) + yy * yy));
}
