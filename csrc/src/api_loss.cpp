// C API of the loss and of blur: checks arguments and calls them.
#include "api.h"
#include "blur.h"
#include "gscore/loss.h"
#include "raster.h"

using namespace gs;

gs_status gs_image_loss(gs_raster *raster, const gs_loss_args *args, gs_loss_result *result, float *v_image) {
    if (!raster || !args || !result)
        return fail(GS_BAD_ARGUMENT, "gs_image_loss: an argument is null");
    if (const gs_status s = check_loss(*args))
        return s;
    if (const gs_status s = check_threads(args->threads))
        return s;
    return guarded("gs_image_loss", [&] { return raster->image_loss(*args, *result, v_image); });
}

gs_status gs_blur_image(const gs_blur_args *args, float *blurred) {
    if (!args || !args->image || !blurred || args->image == blurred)
        return fail(GS_BAD_ARGUMENT, "gs_blur_image: an argument is null, or both pictures are one");
    if (const gs_status s = check_image_size(args->width, args->height))
        return s;
    if (const gs_status s = check_threads(args->threads))
        return s;
    if (const gs_status s = check_blur(args->covariance))
        return s;
    return guarded("gs_blur_image", [&] {
        blur_image(*args, blurred);
        return GS_OK;
    });
}
