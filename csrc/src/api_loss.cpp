// C API of the loss: checks arguments and calls it.
#include "api.h"
#include "gscore/loss.h"
#include "raster.h"

#include <limits>

using namespace gs;

gs_status gs_image_loss(gs_raster *raster, const gs_loss_args *args, gs_loss_result *result, float *v_image) {
    if (!raster || !args || !result || !args->image || !args->target)
        return fail(GS_BAD_ARGUMENT, "gs_image_loss: an argument is null");
    if (const gs_status s = check_image_size(args->width, args->height))
        return s;
    if (args->mask_mode < GS_MASK_NONE || args->mask_mode > GS_MASK_IGNORE ||
        (args->mask_mode != GS_MASK_NONE && !args->mask))
        return fail(GS_BAD_ARGUMENT, "mask_mode must be 0, 1 or 2, with a mask unless 0; got %d", args->mask_mode);
    if (!(args->ssim_weight >= 0 && args->ssim_weight <= 1))
        return fail(GS_BAD_ARGUMENT, "ssim_weight must be 0 to 1, got %g", double(args->ssim_weight));
    for (int c = 0; args->gain && c < 3; ++c)
        if (!(args->gain[c] > 0 && args->gain[c] <= std::numeric_limits<float>::max()))
            return fail(GS_BAD_ARGUMENT, "gain must be above 0 and finite, got %g", double(args->gain[c]));
    if (const gs_status s = check_threads(args->threads))
        return s;
    return guarded("gs_image_loss", [&] { return raster->image_loss(*args, *result, v_image); });
}
