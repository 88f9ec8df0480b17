// C API of mesh depth: checks arguments and calls it.
#include "api.h"
#include "mesh_depth.h"

#include <cmath>

using namespace gs;

namespace {

// Whether all numbers are; without branches, so that compilers make vectors of it.
bool are_valid(const gs_mesh &mesh) {
    bool valid = true;
    for (int64_t i = 0; i < 3 * mesh.corner_count; ++i)
        valid &= std::fabs(mesh.corners[i]) <= kMeshLargest;
    for (int64_t i = 0; i < 3 * mesh.triangle_count; ++i)
        valid &= uint32_t(mesh.triangles[i]) < uint32_t(mesh.corner_count);
    return valid;
}

gs_status check_mesh(const gs_mesh &mesh) {
    if (mesh.corner_count < 0 || mesh.corner_count > INT32_MAX || mesh.triangle_count < 0)
        return fail(GS_BAD_ARGUMENT,
                    "a mesh must have 0 to 2147483647 corners and 0 or more triangles, got %lld and %lld",
                    (long long)mesh.corner_count, (long long)mesh.triangle_count);
    if ((mesh.corner_count > 0 && !mesh.corners) || (mesh.triangle_count > 0 && !mesh.triangles))
        return fail(GS_BAD_ARGUMENT, "the corners or triangles of a mesh are null");
    if (are_valid(mesh))
        return GS_OK;
    for (int64_t i = 0; i < 3 * mesh.corner_count; ++i)
        if (!(std::fabs(mesh.corners[i]) <= kMeshLargest))
            return fail(GS_BAD_ARGUMENT, "corner %lld of a mesh is not finite or above 1e50", (long long)(i / 3));
    for (int64_t i = 0; i < 3 * mesh.triangle_count; ++i)
        if (mesh.triangles[i] < 0 || mesh.triangles[i] >= mesh.corner_count)
            return fail(GS_BAD_ARGUMENT, "triangle %lld of a mesh has corner index %d, expected less than %lld",
                        (long long)(i / 3), mesh.triangles[i], (long long)mesh.corner_count);
    return GS_OK;
}

} // namespace

gs_status gs_mesh_depth(const gs_mesh *mesh, double near_plane, int32_t width, int32_t height, int32_t threads,
                        float *inverse_depth) {
    if (!mesh || !inverse_depth)
        return fail(GS_BAD_ARGUMENT, "gs_mesh_depth: an argument or an array is null");
    if (!(near_plane >= 0))
        return fail(GS_BAD_ARGUMENT, "near_plane must be at least 0, got %g", near_plane);
    if (const gs_status s = check_image_size(width, height))
        return s;
    if (const gs_status s = check_mesh(*mesh))
        return s;
    if (const gs_status s = check_threads(threads))
        return s;
    return guarded("gs_mesh_depth", [&] {
        mesh_depth(*mesh, near_plane, width, height, threads, inverse_depth);
        return GS_OK;
    });
}
