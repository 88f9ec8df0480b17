// C API of gscore_gpu: checks arguments and calls it.
#include "api_gpu.h"
#include "gpu.h"

#include <memory>

using namespace gs;

int32_t gs_gpu_abi_version(void) { return GS_GPU_ABI_VERSION; }
const char *gs_gpu_last_error(void) { return last_failure(); }

gs_status gs_gpu_devices(gs_gpu_info *out, int32_t capacity, int32_t *count) {
    if (!count || capacity < 0 || (capacity && !out))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_devices: an argument is null or the capacity negative");
    *count = 0;
    return run("gs_gpu_devices", [&] {
        const std::vector<VkPhysicalDevice> devices = physical_devices();
        for (size_t i = 0; i < devices.size() && i < size_t(capacity); ++i)
            out[i] = describe(devices[i]);
        *count = int32_t(devices.size());
        return GS_OK;
    });
}

gs_status gs_gpu_open(int32_t index, gs_gpu **out) {
    if (!out)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_open: out is null");
    return run("gs_gpu_open", [&] {
        const std::vector<VkPhysicalDevice> devices = physical_devices();
        if (index < 0 || size_t(index) >= devices.size())
            return fail(GS_BAD_ARGUMENT, "gs_gpu_open: there is no device %d; there are %zu", index, devices.size());
        *out = new gs_gpu(devices[size_t(index)]);
        return GS_OK;
    });
}

void gs_gpu_close(gs_gpu *gpu) { delete gpu; }

gs_status gs_gpu_upload(gs_gpu *gpu, const gs_splats *splats, gs_gpu_splats **out) {
    if (!gpu || !splats || !out)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_upload: an argument is null");
    if (const gs_status s = check_splats(*splats))
        return s;
    return run("gs_gpu_upload", [&] {
        auto made = std::make_unique<gs_gpu_splats>();
        try {
            gpu->upload(*splats, *made);
        } catch (...) {
            gpu->device.free(made->model);
            throw;
        }
        *out = made.release();
        return GS_OK;
    });
}

void gs_gpu_release(gs_gpu_splats *splats) {
    if (splats)
        splats->gpu->release(*splats);
    delete splats;
}

gs_status gs_gpu_draw(gs_gpu *gpu, const gs_gpu_splats *splats, const gs_view *view, const gs_host *host,
                      const gs_image *image) {
    if (!gpu || !splats || !view || !host || !image || !image->rgb || !image->alpha)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_draw: an argument, image.rgb or image.alpha is null");
    if (const gs_status s = check_draw(splats->sh_rest, *view, *image))
        return s;
    return run("gs_gpu_draw", [&] {
        gpu->draw(*splats, *view, *host, *image);
        return GS_OK;
    });
}

gs_status gs_gpu_weights(gs_gpu *gpu, const gs_gpu_splats *splats, const float *shares, float *sums) {
    if (!gpu || !splats || !shares || (!sums && splats->count))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_weights: an argument is null");
    return run("gs_gpu_weights", [&] {
        gpu->weights(*splats, shares, sums);
        return GS_OK;
    });
}

gs_status gs_gpu_backward(gs_gpu *gpu, const gs_gpu_splats *splats, const gs_image_grads *image_grads,
                          const gs_splat_grads *grads) {
    if (!gpu || !splats || !image_grads || !grads)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_backward: an argument is null");
    if (splats->count > 0 && (!grads->means || !grads->quats || !grads->scales || !grads->opacities || !grads->sh0 ||
                              (splats->sh_rest && !grads->shN)))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_backward: an array of grads is null");
    return run("gs_gpu_backward", [&] {
        gpu->backward(*splats, *image_grads, *grads);
        return GS_OK;
    });
}

gs_status gs_gpu_draw_stats(const gs_gpu *gpu, gs_gpu_stats *out) {
    if (!gpu || !out)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_draw_stats: an argument is null");
    *out = gpu->stats;
    return GS_OK;
}

gs_status gs_gpu_memory_use(const gs_gpu *gpu, gs_gpu_memory *out) {
    if (!gpu || !out)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_memory_use: an argument is null");
    *out = gpu->device.memory();
    return GS_OK;
}

gs_status gs_gpu_shorten_submissions(gs_gpu *gpu, int64_t bytes) {
    if (!gpu || bytes < (1 << 20))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_shorten_submissions: gpu is null, or bytes are less than 1 MiB");
    return run("gs_gpu_shorten_submissions", [&] {
        gpu->device.shorten_submissions(size_t(bytes));
        return GS_OK;
    });
}

gs_status gs_gpu_profile(gs_gpu *gpu, int32_t on) {
    if (!gpu)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_profile: gpu is null");
    gpu->device.profile(on != 0);
    return GS_OK;
}

gs_status gs_gpu_kernel_time(const gs_gpu *gpu, int32_t number, const char **name, double *milliseconds,
                             int64_t *calls) {
    if (!gpu || !name || !milliseconds || !calls || number < 0 || number >= kShaders)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_kernel_time: an argument is null, or there is no kernel %d", number);
    const Device::KernelTime time = gpu->device.kernel_time(Shader(number));
    *name = shader_code(Shader(number)).name;
    *milliseconds = time.milliseconds;
    *calls = time.calls;
    return GS_OK;
}

gs_status gs_gpu_projected(gs_gpu *gpu, float *means2d, float *depths, float *conics, float *colors, float *opacities) {
    if (!gpu)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_projected: gpu is null");
    return run("gs_gpu_projected", [&] {
        gpu->projected({means2d, depths, conics, colors, opacities});
        return GS_OK;
    });
}

gs_status gs_gpu_test(gs_gpu *gpu, int32_t kernel, const uint32_t *a, const uint32_t *b, uint32_t *out, int64_t count) {
    const bool two = kernel >= GS_GPU_TEST_PRODUCT && kernel <= GS_GPU_TEST_FMA;
    if (!gpu || kernel < 0 || kernel > GS_GPU_TEST_CHAIN || count < 0 || count > (int64_t(1) << 28) ||
        (count && (!a || !out || (two && !b))))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_test: an argument is null or out of range");
    return run("gs_gpu_test", [&] {
        gpu->test(kernel, a, b, out, count);
        return GS_OK;
    });
}
