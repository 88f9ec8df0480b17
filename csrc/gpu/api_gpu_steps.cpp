// C API of training steps: checks arguments and calls them.
#include "api_gpu.h"
#include "model.h"

#include <cmath>
#include <memory>

using namespace gs;

namespace {

bool is_slot(int32_t slot) { return 0 <= slot && slot < GS_GPU_STEPS_MAX; }

gs_status check_step(const gs_gpu_model &model, const gs_gpu_step &s) {
    float pixel = 0;
    const gs_image picture = {&pixel, &pixel, &pixel, &pixel, &pixel, nullptr};
    if (const gs_status status = check_draw(model.splats.sh_rest, s.view, picture))
        return status;
    if (s.view.orthographic || s.view.sh_degree > 3)
        return fail(GS_BAD_ARGUMENT, "a step needs a perspective view and SH of degree 0 to 3");
    if (s.kept && (s.kept->gpu != model.gpu || s.kept->width != s.view.width || s.kept->height != s.view.height ||
                   (s.photo ? s.kept->has_mask != (s.mask != nullptr) : s.mask || !s.kept->written)))
        return fail(GS_BAD_ARGUMENT, "a step's kept photo is of another device or size, or was not written yet");
    const bool has_mask = s.mask || (s.kept && s.kept->has_mask);
    if (!(s.photo || s.kept) || (s.mask_mode != GS_MASK_NONE && !has_mask) || s.mask_mode < 0 ||
        s.mask_mode > GS_MASK_IGNORE)
        return fail(GS_BAD_ARGUMENT, "a step has no photo or no mask, or an unknown mask mode");
    if (s.has_blur)
        if (const gs_status status = check_blur(s.blur))
            return status;
    if (s.pauses && !(s.view.outputs & GS_OUT_INVERSE_DEPTH))
        return fail(GS_BAD_ARGUMENT, "a step that pauses needs GS_OUT_INVERSE_DEPTH");
    if (!(s.drop_rate >= 0 && s.drop_rate < 1) || !(s.noise >= 0) || !(s.extent > 0))
        return fail(GS_BAD_ARGUMENT, "drop_rate must be in [0, 1), noise at least 0 and extent positive");
    if (s.gradient_counter >= model.counter_count || s.view_counter >= model.counter_count ||
        (s.gradient_counter >= 0) != (s.view_counter >= 0))
        return fail(GS_BAD_ARGUMENT, "a counter of a step is out of range");
    for (int i = 0; i < 6; ++i)
        if (!std::isfinite(s.rates[i]) || s.steps[i] < 0)
            return fail(GS_BAD_ARGUMENT, "rate %d is not finite or its step is negative", i);
    if (s.updates && !model.has_moments)
        return fail(GS_BAD_ARGUMENT, "the model's moments were freed");
    return GS_OK;
}

} // namespace

gs_status gs_gpu_step_request(gs_gpu *gpu, gs_gpu_model *model, const gs_gpu_step *step, int32_t slot) {
    if (!gpu || !model || !step || !is_slot(slot) || model->gpu != gpu)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_step_request: an argument is null or out of range");
    if (const gs_status s = check_step(*model, *step))
        return s;
    return run("gs_gpu_step_request", [&] {
        gpu->request_step(*model, *step, slot);
        return GS_OK;
    });
}

gs_status gs_gpu_step_picture(gs_gpu *gpu, int32_t slot, float *inverse_depth, float *alpha) {
    if (!gpu || !is_slot(slot) || !inverse_depth || !alpha)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_step_picture: an argument is null or out of range");
    return run("gs_gpu_step_picture", [&] {
        gpu->read_step_picture(slot, inverse_depth, alpha);
        return GS_OK;
    });
}

gs_status gs_gpu_step_resume(gs_gpu *gpu, int32_t slot, double value, const float *v_inverse_depth,
                             const float *v_alpha) {
    if (!gpu || !is_slot(slot))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_step_resume: an argument is null or out of range");
    return run("gs_gpu_step_resume", [&] {
        gpu->resume_step(slot, value, v_inverse_depth, v_alpha);
        return GS_OK;
    });
}

gs_status gs_gpu_step_result(gs_gpu *gpu, int32_t slot, gs_gpu_step_numbers *out) {
    if (!gpu || !is_slot(slot) || !out)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_step_result: an argument is null or out of range");
    return run("gs_gpu_step_result", [&] {
        gpu->read_step(slot, *out);
        return GS_OK;
    });
}

gs_status gs_gpu_photo_create(gs_gpu *gpu, int32_t width, int32_t height, int32_t has_mask, gs_gpu_photo **out) {
    if (!gpu || !out)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_photo_create: an argument is null");
    if (const gs_status s = check_image_size(width, height))
        return s;
    return run("gs_gpu_photo_create", [&] {
        auto made = std::make_unique<gs_gpu_photo>(gs_gpu_photo{gpu, {}, {}, width, height, has_mask != 0, false});
        const size_t pixels = size_t(width) * size_t(height);
        try {
            gpu->device.ensure(made->image, (3 * pixels + 15) / 16 * 16);
            gpu->device.ensure(made->mask, has_mask ? (pixels + 15) / 16 * 16 : 0);
        } catch (...) {
            gpu->device.free(made->image);
            gpu->device.free(made->mask);
            throw;
        }
        *out = made.release();
        return GS_OK;
    });
}

void gs_gpu_photo_free(gs_gpu_photo *photo) {
    if (!photo)
        return;
    photo->gpu->device.free(photo->image);
    photo->gpu->device.free(photo->mask);
    delete photo;
}

gs_status gs_gpu_steps_release(gs_gpu *gpu) {
    if (!gpu)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_steps_release: gpu is null");
    return run("gs_gpu_steps_release", [&] {
        gpu->release_steps();
        return GS_OK;
    });
}
