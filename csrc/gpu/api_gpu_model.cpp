// C API of gscore_gpu, splats in training: checks arguments and calls it.
#include "api_gpu.h"
#include "model.h"

using namespace gs;

gs_status gs_gpu_model_create(gs_gpu *gpu, const gs_splats *splats, const gs_splats *frozen, int32_t counters,
                              gs_gpu_model **out) {
    if (!gpu || !splats || !out || counters < 0 || counters > 64)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_create: an argument is null, or counters are not 0 to 64");
    for (const gs_splats *s : {splats, frozen}) {
        if (!s)
            continue;
        if (const gs_status status = check_splats(*s))
            return status;
        if (s->raw != 1 || s->sh_rest > splats->sh_rest)
            return fail(GS_BAD_ARGUMENT, "gs_gpu_model_create: splats are not raw, or frozen ones have more SH "
                                         "coefficients than the others");
    }
    return run("gs_gpu_model_create", [&] {
        *out = new gs_gpu_model(gpu, *splats, frozen, counters);
        return GS_OK;
    });
}

void gs_gpu_model_destroy(gs_gpu_model *model) { delete model; }
