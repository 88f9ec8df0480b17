// Gradients of a row, and of the camera.

// Gradients of a row; false: they are zero, because the splat is not in the picture.
bool gradients_of(uint row, out Projection p, out Gradients g) {
    bool visible = row < frame.count && frame.keys.at[min(row, frame.count - 1)] != GS_NO_KEY;
    if (visible)
        visible = place(row, p);
    if (visible) {
        linearise(p);
        g = chain(row, p, load_splat(row), load_moments(row));
    } else {
        g.mean = g.scale = g.color = g.direction = vec3(0.0);
        g.opacity = 0.0;
        g.quat = vec4(0.0);
        g.mean2d = vec2(0.0);
    }
    return visible;
}

shared vec4 camera_shared[GS_GROUP];

// Adds the gradients of the upper three rows of viewmat over the workgroup, in a fixed order, into its part. To be called
// by all invocations.
void store_camera_parts(bool visible, Projection p, Gradients g) {
    for (int i = 0; i < 3; ++i) {
        vec4 v = vec4(0.0);
        if (visible) {
            // W acts on the mean, on R, and through the centre -W^T t on the viewing direction.
            vec4 w = frame.view.viewmat[i];
            for (int j = 0; j < 3; ++j)
                v[j] = g.v_cam[i] * p.mean[j] + w.w * g.v_from_centre[j] +
                       (g.v_world_rot[0][i] * p.rot[0][j] + g.v_world_rot[1][i] * p.rot[1][j] + g.v_world_rot[2][i] * p.rot[2][j]);
            v.w = g.v_cam[i] + sum3(w.xyz, g.v_from_centre);
        }
        camera_shared[lane()] = v;
        barrier();
        for (uint reach = GS_GROUP / 2; reach > 0; reach /= 2) {
            if (lane() < reach)
                camera_shared[lane()] += camera_shared[lane() + reach];
            barrier();
        }
        if (lane() < 4 && group_number() * GS_GROUP < frame.count) // a folded dispatch has more groups
            training.camera_parts.at[12 * group_number() + 4 * uint(i) + lane()] = camera_shared[0][lane()];
        barrier();
    }
}

// Gradient of plane `plane` of the SH coefficients.
vec4 sh_plane(uint plane, vec3 direction, vec3 v) {
    uint group = plane / 3, part = plane % 3;
    vec4 b = harmonics_of(group, direction);
    return part == 0   ? vec4(v * b.x, v.r * b.y)
           : part == 1 ? vec4(v.gb * b.y, v.rg * b.z)
                       : vec4(v.b * b.z, v * b.w);
}
