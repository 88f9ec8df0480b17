/* Depth of triangle meshes. */
#pragma once

#include "base.h"

/* Triangle mesh in homogeneous pixel coordinates of a camera: a corner is (u z, v z, z), K times its position in the
 * camera's axes, with pixel (u, v) and depth z. Corners may be behind the camera. */
typedef struct gs_mesh {
    int64_t corner_count;     /* V, up to 2147483647 */
    const double *corners;    /* [V, 3], magnitudes up to 1e50 */
    int64_t triangle_count;   /* T */
    const int32_t *triangles; /* [T, 3] rows of `corners`; two-sided */
} gs_mesh;

/* Compute 1 / z of the nearest triangle at each pixel centre, [H, W]; 0 where there is none. Triangles are clipped at
 * z = near_plane if that is above 0. Bands of rows are drawn by `threads` threads, 0: gs_default_threads(). */
GS_API gs_status gs_mesh_depth(const gs_mesh *mesh, double near_plane, int32_t width, int32_t height, int32_t threads,
                               float *inverse_depth);
