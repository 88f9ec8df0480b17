// C API of stereo: checks arguments and calls it.
#include "api.h"
#include "stereo.h"

#include <cmath>

using namespace gs;

namespace {

gs_status check_side(const char *what, int32_t width, int32_t height) {
    if (width < 2 || width > GS_STEREO_SIDE_MAX || height < 2 || height > GS_STEREO_SIDE_MAX)
        return fail(GS_BAD_ARGUMENT, "%s must be 2 to %d px per side, got %d x %d", what, GS_STEREO_SIDE_MAX, width,
                    height);
    return GS_OK;
}

gs_status check_warp(const gs_stereo_warp &warp) {
    for (const float v : warp.rotation)
        if (!std::isfinite(v))
            return fail(GS_BAD_ARGUMENT, "a warp has a value that is not finite");
    for (const float v : warp.translation)
        if (!std::isfinite(v))
            return fail(GS_BAD_ARGUMENT, "a warp has a value that is not finite");
    return GS_OK;
}

gs_status check_sources(const gs_stereo_sweep_args &a) {
    if (a.source_count < 1 || a.source_count > GS_STEREO_SOURCES_MAX || !a.sources)
        return fail(GS_BAD_ARGUMENT, "there must be 1 to %d sources, got %d", GS_STEREO_SOURCES_MAX, a.source_count);
    for (int32_t i = 0; i < a.source_count; ++i) {
        if (const gs_status s = check_side("a source", a.sources[i].width, a.sources[i].height))
            return s;
        if (const gs_status s = check_warp(a.sources[i].warp))
            return s;
        if (!a.sources[i].grey)
            return fail(GS_BAD_ARGUMENT, "the grey values of a source are null");
    }
    return GS_OK;
}

gs_status check_sweep(const gs_stereo_sweep_args &a) {
    if (const gs_status s = check_side("the reference", a.width, a.height))
        return s;
    if (!(a.farthest >= 0 && a.nearest > a.farthest && std::isfinite(a.nearest)))
        return fail(GS_BAD_ARGUMENT, "inverse depths must be at least 0 and increase, got %g to %g", double(a.farthest),
                    double(a.nearest));
    if (a.planes < GS_STEREO_PLANES_MIN || a.planes > GS_STEREO_PLANES_MAX)
        return fail(GS_BAD_ARGUMENT, "planes must be %d to %d, got %d", GS_STEREO_PLANES_MIN, GS_STEREO_PLANES_MAX,
                    a.planes);
    if (a.radius < 1 || a.radius > GS_STEREO_RADIUS_MAX)
        return fail(GS_BAD_ARGUMENT, "radius must be 1 to %d px, got %d", GS_STEREO_RADIUS_MAX, a.radius);
    if (a.best != 1 && a.best != 2)
        return fail(GS_BAD_ARGUMENT, "best must be 1 or 2 sources, got %d", a.best);
    if (!(a.noise > 0 && a.noise <= 255))
        return fail(GS_BAD_ARGUMENT, "noise must be more than 0 and at most 255, got %g", double(a.noise));
    if (const gs_status s = check_sources(a))
        return s;
    return check_threads(a.threads);
}

gs_status check_neighbours(const gs_stereo_check_args &a) {
    if (a.neighbour_count < 0 || a.neighbour_count > 255 || (a.neighbour_count > 0 && !a.neighbours))
        return fail(GS_BAD_ARGUMENT, "neighbour_count must be 0 to 255, got %d", a.neighbour_count);
    for (int32_t i = 0; i < a.neighbour_count; ++i) {
        const gs_stereo_neighbour &neighbour = a.neighbours[i];
        if (const gs_status s = check_side("a neighbour", neighbour.width, neighbour.height))
            return s;
        if (const gs_status s = check_warp(neighbour.warp))
            return s;
        if (const gs_status s = check_warp(neighbour.back))
            return s;
        if (!neighbour.inverse_depth)
            return fail(GS_BAD_ARGUMENT, "the depth map of a neighbour is null");
    }
    return GS_OK;
}

} // namespace

gs_status gs_stereo_sweep(const gs_stereo_sweep_args *args, const gs_stereo_found *found) {
    if (!args || !found || !args->grey || !found->inverse_depth || !found->score || !found->second_best ||
        !found->contrast)
        return fail(GS_BAD_ARGUMENT, "gs_stereo_sweep: an argument or an array is null");
    if (const gs_status s = check_sweep(*args))
        return s;
    return guarded("gs_stereo_sweep", [&] {
        const gs_status s = stereo_sweep(*args, *found);
        return s == GS_CANCELLED ? fail(s, "cancelled") : s;
    });
}

gs_status gs_stereo_check(const gs_stereo_check_args *args, uint8_t *agree, uint8_t *contradict, float *inverse_depth) {
    if (!args || !args->inverse_depth || !agree || !contradict || !inverse_depth)
        return fail(GS_BAD_ARGUMENT, "gs_stereo_check: an argument or an array is null");
    if (const gs_status s = check_side("the reference", args->width, args->height))
        return s;
    if (!(args->pixels >= 0 && args->relative >= 0 && args->passed >= 0))
        return fail(GS_BAD_ARGUMENT, "pixels, relative and passed must not be negative");
    if (const gs_status s = check_neighbours(*args))
        return s;
    if (const gs_status s = check_threads(args->threads))
        return s;
    return guarded("gs_stereo_check", [&] {
        stereo_check(*args, agree, contradict, inverse_depth);
        return GS_OK;
    });
}
