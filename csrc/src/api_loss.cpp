// C API of the loss: checks arguments and calls it.
#include "api.h"
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
