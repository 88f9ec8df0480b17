// Projection of a splat (EWA, Zwicker et al. 2001): what drawing and its gradients need. The formulas are those of
// csrc/src/project.inl.h.

// Highest opacity of dropout, as in gscore/engine/cpu/splat_terms.py; blending clamps it further.
#define GS_RAISED_MAX 0.999

bool finite(vec3 v) { return finite(v.x) && finite(v.y) && finite(v.z); }

float sum3(vec3 a, vec3 b) { return a.x * b.x + (a.y * b.y + a.z * b.z); }

// A splat in the camera's frame, with M = J W R S of its 2D covariance M M^T + eps2d I.
struct Projection {
    vec3 mean, scale;
    vec4 quat;         // normalised, wxyz
    float quat_length;
    float opacity;     // activated, before dropout
    float see_through; // 1 - opacity, without cancellation near 1
    float raised;      // opacity after dropout
    vec3 cam;
    float inverse_z;
    vec2 ratio, clamped; // x / z and y / z, and clamped for the Jacobian
    vec2 diagonal, offset; // J = [d.x 0 o.x; 0 d.y o.y]
    mat3 rot;              // R
    mat3 world_rot;        // W R, columns
    vec3 m0, m1;           // rows of M
    vec3 minor;            // of columns 12, 20, 01
    float cov_xx, cov_xy, cov_yy, det0, det;
    float compensation; // opacity factor
    vec2 mean2d;
};

// A row of the camera's rotation: the matrix is row-major, so GLSL's columns are its rows. Whole columns are read, because
// the compiler takes a single component to be aligned as its column, and lavapipe then reads another.
#define CAMERA_ROW(i) frame.view.viewmat[i].xyz

// Rotation matrix of a quaternion wxyz of any length; false if it has no direction.
bool rotation(inout Projection p) {
    vec4 a = abs(p.quat);
    float largest = max(max(a.x, a.y), max(a.z, a.w));
    // Divided by the largest component first, so that no length over- or underflows.
    float shrink = 1.0 / max(largest, GS_QUAT_MIN);
    vec4 q = p.quat * shrink;
    float norm = sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    q /= norm;
    p.quat = q;
    p.quat_length = norm / shrink;
    float w = q.x, x = q.y, y = q.z, z = q.w;
    // Columns.
    p.rot[0] = vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
    p.rot[1] = vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
    p.rot[2] = vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
    return largest >= GS_QUAT_MIN;
}

// Splat between the planes of the view, with finite numbers; false: it is not drawn.
bool place(uint row, out Projection p) {
    uint n = frame.count;
    vec4 mean_opacity = frame.model.at[GS_PLANE_MEAN * n + row];
    p.mean = mean_opacity.xyz;
    mat4 world_to_camera = frame.view.viewmat;
    vec3 shift = vec3(world_to_camera[0].w, world_to_camera[1].w, world_to_camera[2].w);
    p.cam = vec3(sum3(CAMERA_ROW(0), p.mean), sum3(CAMERA_ROW(1), p.mean), sum3(CAMERA_ROW(2), p.mean)) + shift;
    if (!finite(p.mean) || !finite(p.cam) || !(p.cam.z > frame.view.near_plane && p.cam.z <= frame.view.far_plane))
        return false;
    p.quat = frame.model.at[GS_PLANE_QUAT * n + row];
    p.scale = frame.model.at[GS_PLANE_SCALE * n + row].xyz;
    p.opacity = mean_opacity.w;
    if (!finite(p.quat.xyz) || !finite(p.quat.w) || !finite(p.scale) || !finite(p.opacity))
        return false;
    p.see_through = 1.0 - p.opacity;
    if (frame.raw != 0) {
        p.scale = vec3(exp_polynomial(p.scale.x), exp_polynomial(p.scale.y), exp_polynomial(p.scale.z));
        float e = exp_polynomial(-p.opacity);
        p.opacity = 1.0 / (1.0 + e);
        p.see_through = e * p.opacity;
    }
    p.raised = p.opacity;
    if (frame.drop_rate > 0.0 && row >= training.frozen) {
        uint block = (row - training.frozen + frame.step % GS_DROPOUT_ROWS) / GS_DROPOUT_ROWS;
        uvec4 words = random_words(block, frame.step, frame.stream, uvec2(frame.seed_low, frame.seed_high));
        if (uniform_number(words) < frame.drop_rate)
            return false;
        p.raised = min(p.opacity / (1.0 - frame.drop_rate), GS_RAISED_MAX);
    }
    return rotation(p);
}

// Projected mean, Jacobian, M, 2D covariance and compensation; false: the splat is not drawn.
bool linearise(inout Projection p) {
    bool parallel = frame.view.orthographic != 0;
    p.inverse_z = 1.0 / p.cam.z;
    vec2 focal = vec2(frame.view.fx, frame.view.fy), centre = vec2(frame.view.cx, frame.view.cy);
    vec2 size = vec2(float(frame.view.width), float(frame.view.height));
    if (parallel) {
        p.diagonal = focal;
        p.offset = vec2(0.0);
        p.mean2d = focal * p.cam.xy + centre;
    } else {
        // Limits of x / z and y / z in the Jacobian, because the linearisation degenerates far off screen.
        vec2 margin = GS_JACOBIAN_MARGIN * (0.5 * size / focal);
        p.ratio = p.cam.xy * p.inverse_z;
        p.clamped = min(max(p.ratio, -centre / focal - margin), (size - centre) / focal + margin);
        p.diagonal = focal * p.inverse_z;
        p.offset = -p.diagonal * p.clamped;
        p.mean2d = focal * p.ratio + centre;
    }
    for (int k = 0; k < 3; ++k) {
        p.world_rot[k] = vec3(sum3(CAMERA_ROW(0), p.rot[k]), sum3(CAMERA_ROW(1), p.rot[k]), sum3(CAMERA_ROW(2), p.rot[k]));
        p.m0[k] = (p.diagonal.x * p.world_rot[k].x + p.offset.x * p.world_rot[k].z) * p.scale[k];
        p.m1[k] = (p.diagonal.y * p.world_rot[k].y + p.offset.y * p.world_rot[k].z) * p.scale[k];
    }
    // The determinant of M M^T is the sum of M's squared minors (Cauchy-Binet), which does not cancel for needles.
    for (int k = 0; k < 3; ++k) {
        int i = k == 2 ? 0 : k + 1, j = k == 0 ? 2 : k - 1;
        Pair a = two_product(p.m0[i], p.m1[j]), b = two_product(p.m0[j], p.m1[i]);
        p.minor[k] = (a.x - b.x) + (a.y - b.y);
    }
    float eps = frame.view.eps2d;
    float xx = sum3(p.m0, p.m0), yy = sum3(p.m1, p.m1);
    p.cov_xy = sum3(p.m0, p.m1);
    p.cov_xx = xx + eps;
    p.cov_yy = yy + eps;
    p.det0 = sum3(p.minor, p.minor);
    p.det = eps * (xx + yy + eps) + p.det0;
    p.compensation = frame.view.antialias != 0 ? max(sqrt(p.det0 / p.det), GS_COMPENSATION_MIN) : 1.0;
    // Beyond float's range (a deviation of some 1e9 px) a splat cannot be drawn.
    return finite(p.det) && p.det > 0.0 && p.det <= 3e38;
}

// Camera centre to mean, by W^T (W mean + t), exact also far from the origin; parallel rays all run along W^T z.
vec3 from_centre(Projection p) {
    if (frame.view.orthographic != 0)
        return CAMERA_ROW(2);
    return CAMERA_ROW(0) * p.cam.x + (CAMERA_ROW(1) * p.cam.y + CAMERA_ROW(2) * p.cam.z);
}
