// Gradients of a splat's parameters from the sums of its records: the chain rule through blending, projection and colour.
// The formulas are those of csrc/src/project_backward.inl.h; float pairs replace its double precision.

// Sums of blend_backward.comp over all entries of a splat, in the order of its tiles.
struct Moments {
    float g;
    vec2 g_uv;    // with u, with v
    vec3 g_uu_vv; // with u^2, u v, v^2
    vec3 color;
    float inverse_z, z;
};

// Gradients of the raw parameters, of the colour before its lower clamp, and of what all splats share.
struct Gradients {
    vec3 mean;
    float opacity;
    vec4 quat;
    vec3 scale;
    vec3 color;
    vec2 mean2d;
    vec3 direction; // unit, from the camera
    vec3 v_cam, v_from_centre;
    mat3 v_world_rot; // columns
};

Moments load_moments(uint row) {
    vec4 a = vec4(0.0), b = vec4(0.0), c = vec4(0.0);
    uint begin = frame.row_entries.at[row], end = begin + frame.tile_counts.at[row];
    for (uint e = begin; e < end; ++e) {
        a += frame.moments.at[GS_MOMENT_QUADS * e];
        b += frame.moments.at[GS_MOMENT_QUADS * e + 1];
        c += frame.moments.at[GS_MOMENT_QUADS * e + 2];
    }
    return Moments(a.x, a.yz, vec3(a.w, b.xy), vec3(b.zw, c.x), c.y, c.z);
}

// Power of two that brings the largest component of a row to 1 to 2; smaller rows keep their size.
float shrink_of(vec3 row) {
    vec3 a = abs(row);
    uint exponent = floatBitsToUint(max(max(a.x, max(a.y, a.z)), 1.0)) >> 23;
    return uintBitsToFloat((254u - exponent) << 23);
}

// Gradients of the rows of M. With G the matrix of second moments of d and Q the conic, that of the covariance is
// Q G Q / 2, hence (Q G Q) M. G itself is not needed: Q d = (ua u, ub u + vc v) / GS_HALF_LOG2E. ln(compensation) =
// (ln det0 - ln det) / 2 adds -log_gain Q M for its second term. In pairs, because for needles entries of Q G Q are ten
// thousand times the product.
void covariance_backward(Projection p, vec3 second, float log_gain, out vec3 v_m0, out vec3 v_m1) {
    // Scaled by powers of two, which is exact: a splat of 1e18 px has factors that float or two_product cannot hold. xx,
    // det and the minors have factor s^2, s^2 and s, xy has s t, and yy has t^2.
    float t = shrink_of(p.m1), s = min(shrink_of(p.m0), t), eps = frame.view.eps2d;
    vec3 m0 = p.m0 * s, m1 = p.m1 * t;
    Pair xx = Pair(eps * s * s, 0.0), yy = Pair(eps * t * t, 0.0), yy_det = Pair(0.0), xy = Pair(0.0);
    for (int k = 0; k < 3; ++k) {
        xx = sum(xx, two_product(m0[k], m0[k]));
        yy = sum(yy, two_product(m1[k], m1[k]));
        yy_det = sum(yy_det, two_product(p.m1[k] * s, p.m1[k] * s));
        xy = sum(xy, two_product(m0[k], m1[k]));
    }
    // From the minors: for needles xx yy - xy^2 cancels even in pairs.
    Pair det = product(sum(xx, yy_det), eps);
    for (int k = 0; k < 3; ++k) {
        int next = k == 2 ? 0 : k + 1;
        Pair minor = difference(two_product(m0[k], p.m1[next]), two_product(m0[next], p.m1[k]));
        det = sum(det, product(minor, minor));
    }
    // Squares and products of ua, ub = -ratio ua and vc, all over GS_HALF_LOG2E.
    Pair one = Pair(1.0, 0.0), inverse_yy = quotient(one, yy), inverse_det = quotient(one, det);
    Pair ratio = product(xy, inverse_yy) * (t / s), aa = product(yy, inverse_det) * (s / t) * (s / t);
    Pair ac = square_root(inverse_det) * s;
    inverse_yy = inverse_yy * t * t;
    Pair scale = quotient(one, Pair(GS_HALF_LOG2E, 0.0));
    Pair uu = product(product(scale, second.x), aa), uv = product(product(scale, second.y), ac);
    Pair vv = product(product(scale, second.z), inverse_yy);
    Pair k00 = difference(uu, product(aa, log_gain));
    Pair k01 = difference(uv, product(ratio, k00));
    Pair k11 = difference(difference(vv, product(inverse_yy, log_gain)), product(ratio, sum(uv, k01)));
    for (int k = 0; k < 3; ++k) {
        v_m0[k] = to_float(sum(product(k00, p.m0[k]), product(k01, p.m1[k])));
        v_m1[k] = to_float(sum(product(k01, p.m0[k]), product(k11, p.m1[k])));
    }
}

// Adds the first term of the opacity compensation, through the minors.
void compensation_backward(Projection p, float g, inout vec3 v_m0, inout vec3 v_m1) {
    if (!(p.compensation > GS_COMPENSATION_MIN))
        return;
    float gain = g / p.det0;
    for (int k = 0; k < 3; ++k) {
        int i = k == 2 ? 0 : k + 1, j = k == 0 ? 2 : k - 1;
        float v = gain * p.minor[k]; // minor[k] = m0i m1j - m0j m1i
        v_m0[i] += v * p.m1[j];
        v_m1[j] += v * p.m0[i];
        v_m0[j] -= v * p.m1[i];
        v_m1[i] -= v * p.m0[j];
    }
}

// From the rotation matrix, by columns, to a quaternion of any length.
vec4 quat_backward(Projection p, mat3 v) {
    float w = p.quat.x, x = p.quat.y, y = p.quat.z, z = p.quat.w;
    // v[k][i] is the gradient of R_ik.
    vec4 q = vec4(
        2.0 * (x * (v[1][2] - v[2][1]) + y * (v[2][0] - v[0][2]) + z * (v[0][1] - v[1][0])),
        2.0 * (y * (v[1][0] + v[0][1]) + z * (v[2][0] + v[0][2]) + w * (v[1][2] - v[2][1]) - 2.0 * x * (v[1][1] + v[2][2])),
        2.0 * (x * (v[1][0] + v[0][1]) + z * (v[2][1] + v[1][2]) + w * (v[2][0] - v[0][2]) - 2.0 * y * (v[0][0] + v[2][2])),
        2.0 * (x * (v[2][0] + v[0][2]) + y * (v[2][1] + v[1][2]) + w * (v[0][1] - v[1][0]) - 2.0 * z * (v[0][0] + v[1][1])));
    // Through q = p / |p|: remove the component along q, divide by the length.
    float along = q.x * w + (q.y * x + (q.z * y + q.w * z));
    return (q - along * p.quat) / p.quat_length;
}

// Gradient of dL/d(mean in the camera's frame); those of J are by its diagonal and offset.
vec3 screen_backward(Projection p, vec2 v_diagonal, vec2 v_offset, vec2 v_mean2d, float v_inverse_z,
                     float v_z) {
    vec2 focal = vec2(frame.view.fx, frame.view.fy);
    vec3 v_cam;
    for (int i = 0; i < 2; ++i) {
        // diagonal = f / z, offset = -f / z * clamped ratio.
        float v_clamped = -p.diagonal[i] * v_offset[i];
        v_inverse_z += focal[i] * (v_diagonal[i] - p.clamped[i] * v_offset[i]);
        float v_ratio = focal[i] * v_mean2d[i] + (p.clamped[i] == p.ratio[i] ? v_clamped : 0.0);
        v_cam[i] = v_ratio * p.inverse_z;
        v_inverse_z += v_ratio * p.cam[i];
    }
    v_cam.z = v_z - (p.inverse_z * p.inverse_z) * v_inverse_z;
    return v_cam;
}

// `s` is the splat's record of the draw.
Gradients chain(uint row, Projection p, Splat s, Moments m) {
    Gradients out_;
    vec2 uv = m.g_uv * (1.0 / GS_HALF_LOG2E);
    out_.mean2d = vec2(s.ua * uv.x, s.ub * uv.x + s.vc * uv.y);
    vec3 v_m0, v_m1;
    bool compensated = frame.view.antialias != 0 && p.compensation > GS_COMPENSATION_MIN;
    covariance_backward(p, m.g_uu_vv, compensated ? m.g : 0.0, v_m0, v_m1);
    if (frame.view.antialias != 0)
        compensation_backward(p, m.g, v_m0, v_m1);

    // alpha is proportional to the opacity.
    out_.opacity = frame.raw != 0 ? m.g * p.see_through : m.g / p.opacity;
    if (frame.drop_rate > 0.0 && row >= training.frozen) // the opacity was divided by 1 - rate, and clamped; the clamp passes gradients
        out_.opacity = m.g / p.raised / (1.0 - frame.drop_rate) * (frame.raw != 0 ? p.opacity * p.see_through : 1.0);

    vec2 v_diagonal = vec2(0.0), v_offset = vec2(0.0);
    for (int k = 0; k < 3; ++k) {
        float proj0 = p.diagonal.x * p.world_rot[k].x + p.offset.x * p.world_rot[k].z;
        float proj1 = p.diagonal.y * p.world_rot[k].y + p.offset.y * p.world_rot[k].z;
        out_.scale[k] = (v_m0[k] * proj0 + v_m1[k] * proj1) * (frame.raw != 0 ? p.scale[k] : 1.0);
        float v0 = v_m0[k] * p.scale[k], v1 = v_m1[k] * p.scale[k];
        v_diagonal += vec2(v0 * p.world_rot[k].x, v1 * p.world_rot[k].y);
        v_offset += vec2(v0, v1) * p.world_rot[k].z;
        out_.v_world_rot[k] = vec3(v0 * p.diagonal.x, v1 * p.diagonal.y, v0 * p.offset.x + v1 * p.offset.y);
    }
    vec3 w0 = CAMERA_ROW(0), w1 = CAMERA_ROW(1), w2 = CAMERA_ROW(2);
    mat3 v_rot; // W^T times that of W R
    for (int k = 0; k < 3; ++k)
        v_rot[k] = w0 * out_.v_world_rot[k].x + (w1 * out_.v_world_rot[k].y + w2 * out_.v_world_rot[k].z);
    out_.quat = quat_backward(p, v_rot);
    out_.v_cam = screen_backward(p, v_diagonal, v_offset, out_.mean2d, m.inverse_z, m.z);

    out_.color = vec3(s.color.r > 0.0 ? m.color.r : 0.0, s.color.g > 0.0 ? m.color.g : 0.0, s.color.b > 0.0 ? m.color.b : 0.0);
    vec3 d = from_centre(p);
    float length_ = sqrt(sum3(d, d));
    d /= length_;
    vec3 v_d = direction_backward(row, d, out_.color);
    out_.direction = d;
    out_.v_from_centre = (v_d - sum3(d, v_d) * d) / length_;
    out_.mean = w0 * out_.v_cam.x + (w1 * out_.v_cam.y + w2 * out_.v_cam.z) + out_.v_from_centre;
    return out_;
}
