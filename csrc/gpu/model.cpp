// Splats in training on a device: creation.
#include "model.h"

using namespace gs;

namespace {

constexpr size_t kFloat = sizeof(float), kQuad = 4 * kFloat;

} // namespace

gs_gpu_model::gs_gpu_model(gs_gpu *of, const gs_splats &in, const gs_splats *before, int32_t counted)
    : gpu(of), splats{of, {}, in.count + (before ? before->count : 0), in.sh_rest, 1},
      frozen(before ? before->count : 0), counter_count(counted) {
    check_size(splats.count, in.sh_rest);
    Device &device = gpu->device;
    const size_t bytes = planes() * rows() * kQuad;
    const struct {
        DeviceBuffer &buffer;
        size_t bytes;
    } tables[] = {{splats.model, bytes},
                  {moment1, bytes},
                  {moment2, bytes},
                  {accumulated, (planes() - GS_PLANE_SH) * rows() * kQuad},
                  {counters, size_t(counter_count) * rows() * kFloat}};
    try {
        for (const auto &t : tables) {
            device.ensure(t.buffer, t.bytes);
            device.begin();
            device.fill(t.buffer, t.buffer.bytes, 0);
            device.finish(nullptr);
        }
        if (before)
            gpu->write_rows(*before, splats, 0);
        gpu->write_rows(in, splats, size_t(frozen));
    } catch (...) {
        free_all();
        throw;
    }
}

gs_gpu_model::~gs_gpu_model() { free_all(); }

void gs_gpu_model::free_all() {
    gpu->release(splats);
    if (!gpu->device.is_lost())
        for (DeviceBuffer *b : {&moment1, &moment2, &accumulated, &counters})
            gpu->device.free(*b);
}

// Shaders number the floats of a table by 32 bits.
void gs_gpu_model::check_size(int64_t count, int32_t sh_rest) {
    const int64_t most = int64_t(UINT32_MAX / (4 * planes_of(sh_rest)));
    if (count > most)
        throw_failure(GS_TOO_MANY, "a device trains at most %lld splats with %d SH coefficients, got %lld",
                      (long long)most, 1 + sh_rest, (long long)count);
}
