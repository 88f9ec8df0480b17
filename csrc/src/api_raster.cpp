// C API of the rasterizer: checks arguments and calls it.
#include "api.h"
#include "cpu_dispatch.h"
#include "raster.h"

using namespace gs;

gs_status gs_raster_create(gs_raster **out) {
    if (!out)
        return fail(GS_BAD_ARGUMENT, "out is null");
    return guarded("gs_raster_create", [&] {
        *out = new gs_raster;
        return GS_OK;
    });
}

void gs_raster_destroy(gs_raster *raster) { delete raster; }

gs_status gs_raster_forward(gs_raster *raster, const gs_splats *splats, const gs_view *view, const gs_host *host,
                            const gs_image *image) {
    if (!raster || !splats || !view || !host || !image || !image->rgb || !image->alpha)
        return fail(GS_BAD_ARGUMENT, "gs_raster_forward: an argument, image.rgb or image.alpha is null");
    if (const gs_status s = check_splats(*splats))
        return s;
    if (const gs_status s = check_draw(splats->sh_rest, *view, *image))
        return s;
    if (const gs_status s = check_threads(host->threads))
        return s;
    return guarded("gs_raster_forward", [&] {
        const gs_status s = raster->forward(*splats, *view, *host, *image);
        if (s == GS_TOO_MANY)
            return fail(s,
                        "the splats cover too many tiles: more than 2147483647 entries; use a smaller image or fewer "
                        "screen-filling splats");
        if (s == GS_CANCELLED)
            return fail(s, "cancelled");
        return s;
    });
}

gs_status gs_raster_backward(gs_raster *raster, const gs_splats *splats, const gs_image_grads *image_grads,
                             const gs_splat_grads *grads, const volatile int32_t *cancel) {
    if (!raster || !splats || !image_grads || !grads)
        return fail(GS_BAD_ARGUMENT, "gs_raster_backward: an argument is null");
    if (const gs_status s = check_splats(*splats))
        return s;
    if (splats->count > 0 && (!grads->means || !grads->quats || !grads->scales || !grads->opacities || !grads->sh0 ||
                              (splats->sh_rest && !grads->shN)))
        return fail(GS_BAD_ARGUMENT, "gs_raster_backward: an array of grads is null");
    return guarded("gs_raster_backward", [&] {
        const gs_status s = raster->backward(*splats, *image_grads, *grads, cancel);
        if (s == GS_CANCELLED)
            return fail(s, "cancelled");
        if (s == GS_UNSUPPORTED)
            return fail(s, "gs_raster_backward: the last forward call was orthographic, which has no gradients");
        if (s == GS_BAD_ARGUMENT)
            return fail(s, "gs_raster_backward: there is no forward call of this raster with the same number and "
                           "degree of splats");
        return s;
    });
}

gs_status gs_raster_stats(const gs_raster *raster, gs_stats *out) {
    if (!raster || !out)
        return fail(GS_BAD_ARGUMENT, "gs_raster_stats: an argument is null");
    *out = raster->stats;
    return GS_OK;
}

gs_status gs_raster_projected(const gs_raster *raster, float *means2d, float *depths, float *conics, float *colors,
                              float *opacities) {
    return guarded("gs_raster_projected", [&] {
        if (!raster || raster->projected({means2d, depths, conics, colors, opacities}) != GS_OK)
            return fail(GS_BAD_ARGUMENT, "gs_raster_projected: no forward call has succeeded");
        return GS_OK;
    });
}

gs_status gs_exp2(const float *x, float *y, int64_t count) {
    if (count < 0 || (count > 0 && (!x || !y)))
        return fail(GS_BAD_ARGUMENT, "gs_exp2: an array is null or its length negative");
    return guarded("gs_exp2", [&] {
        kernels().exp2(x, y, count);
        return GS_OK;
    });
}
