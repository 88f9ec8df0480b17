// C API of gscore_gpu, loss of a picture: checks arguments and calls it.
#include "api_gpu.h"
#include "gpu.h"

using namespace gs;

gs_status gs_gpu_loss(gs_gpu *gpu, const gs_loss_args *args, const gs_gpu_loss_terms *terms, gs_gpu_loss_result *result,
                      float *v_image, float *v_alpha) {
    if (!gpu || !args || !terms || !result)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_loss: an argument is null");
    if (const gs_status s = check_loss(*args))
        return s;
    if (terms->has_blur)
        if (const gs_status s = check_blur(terms->blur))
            return s;
    const bool needs_alpha = terms->mask_alpha != 0 || terms->see_through != 0 || terms->fixed_background != 0;
    if ((needs_alpha && !terms->alpha) || terms->rows_at_once < 0)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_loss: alpha is null but needed, or rows_at_once is negative");
    return run("gs_gpu_loss", [&] {
        gpu->loss(*args, *terms, *result, v_image, v_alpha);
        return GS_OK;
    });
}
