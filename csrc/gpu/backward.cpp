// Gradients of a draw, as arrays: for tests and other programs; a training keeps them on the device.
#include "gpu.h"

#include <algorithm>

using namespace gs;

namespace {

constexpr size_t kQuad = 4 * sizeof(float);
// Bytes that take as long as the gradients of an entry at all pixels of its tile.
constexpr size_t kEntryBytes = 512;

// Copies `width` components of the rows, from component `first` on, out of planes.
void read_rows(const float *planes, size_t count, size_t first, size_t width, float *out, bool adds) {
    for (size_t row = 0; row < count; ++row)
        for (size_t k = 0; k < width; ++k) {
            const size_t at = first + k;
            float &to = out[row * width + k];
            to = planes[(at / 4 * count + row) * 4 + at % 4] + (adds ? to : 0);
        }
}

} // namespace

gs_step gs_gpu::blank_step() const {
    gs_step s = {};
    for (uint64_t *p = &s.values; p <= &s.sane; ++p)
        *p = counters_.address;
    return s;
}

void gs_gpu::record_blend_backward(uint32_t what) {
    gs_push p = push(0, what);
    p.values_in = entry_slots_[sorted_entries_].address;
    record_rows(blend_bytes(kEntryBytes), nullptr, [&](uint32_t row, uint32_t rows) {
        p.word0 = row;
        device.dispatch(Shader::kBlendBackward, p, frame_.tiles_x, rows);
    });
}

void gs_gpu::backward(const gs_gpu_splats &splats, const gs_image_grads &in, const gs_splat_grads &out) {
    if (drawn_ != &splats || !(frame_.view.outputs & GS_GPU_GRADIENTS))
        throw_failure(GS_BAD_ARGUMENT, "gs_gpu_backward: these splats were not drawn last, with GS_GPU_GRADIENTS");
    if (frame_.view.orthographic)
        throw_failure(GS_UNSUPPORTED, "gs_gpu_backward: there are no gradients of orthographic views");
    const size_t pixels = size_t(frame_.view.width) * size_t(frame_.view.height), count = size_t(frame_.count);
    const size_t planes = planes_of(splats.sh_rest);
    const std::vector<float> zeros(in.rgb ? 0 : 3 * pixels);
    device.ensure(v_rgb_, 3 * pixels * sizeof(float));
    device.ensure(v_alpha_, (in.alpha ? pixels : 0) * sizeof(float));
    device.ensure(v_inverse_depth_, (in.inverse_depth || in.depth ? pixels : 0) * sizeof(float));
    device.ensure(gradients_, planes * count * kQuad);
    device.ensure(v_means2d_, 2 * count * sizeof(float));
    device.ensure(camera_parts_, 12 * size_t(groups_of(int64_t(count), GS_GROUP)) * sizeof(float));
    device.ensure(camera_, 12 * sizeof(float));
    device.ensure(step_buffer_, sizeof(gs_step));
    const auto array = [](const float *p) { return const_cast<float *>(p); };
    send({{&v_rgb_, array(in.rgb ? in.rgb : zeros.data()), 3 * pixels * sizeof(float)}});
    send({{&v_alpha_, array(in.alpha), in.alpha ? pixels * sizeof(float) : 0}});
    send({{&v_inverse_depth_, array(in.inverse_depth), in.inverse_depth ? pixels * sizeof(float) : 0}});
    frame_.v_rgb = v_rgb_.address;
    frame_.v_alpha = v_alpha_.address;
    frame_.v_inverse_depth = v_inverse_depth_.address;
    frame_.step_block = step_buffer_.address;
    gs_step step = blank_step();
    step.sh_planes = uint32_t(planes - GS_PLANE_SH);
    step.learns_pose = out.viewmat != nullptr;
    step.gradients = gradients_.address;
    step.means2d = v_means2d_.address;
    step.camera_parts = camera_parts_.address;
    step.camera = camera_.address;
    cancel_ = nullptr;
    begin();
    device.update(frame_buffer_, &frame_, sizeof frame_);
    device.update(step_buffer_, &step, sizeof step);
    record_blend_backward((in.alpha ? GS_V_ALPHA : 0) | (in.inverse_depth ? GS_V_DEPTH : 0));
    if (in.depth) {
        submit();
        send({{&v_inverse_depth_, array(in.depth), pixels * sizeof(float)}});
        begin();
        record_blend_backward(GS_V_DEPTH | GS_V_OF_DEPTH);
    }
    const Groups groups(groups_of(int64_t(count), GS_GROUP));
    pace(count * planes * 2 * kQuad + most_entries() * GS_MOMENT_QUADS * kQuad);
    device.dispatch(Shader::kGradients, push(), groups.x, groups.y);
    if (out.viewmat)
        device.dispatch(Shader::kCameraSum, push(), 1);
    submit();

    std::vector<float> found(planes * count * 4);
    fetch({{&gradients_, found.data(), found.size() * sizeof(float)}});
    const size_t rest = 3 * size_t(splats.sh_rest);
    read_rows(found.data(), count, 4 * GS_PLANE_MEAN, 3, out.means, false);
    read_rows(found.data(), count, 4 * GS_PLANE_MEAN + 3, 1, out.opacities, false);
    read_rows(found.data(), count, 4 * GS_PLANE_QUAT, 4, out.quats, false);
    read_rows(found.data(), count, 4 * GS_PLANE_SCALE, 3, out.scales, false);
    read_rows(found.data(), count, 4 * GS_PLANE_SH, 3, out.sh0, false);
    if (rest)
        read_rows(found.data(), count, 4 * GS_PLANE_SH + 3, rest, out.shN, out.add_shN);
    if (out.means2d)
        fetch({{&v_means2d_, out.means2d, 2 * count * sizeof(float)}});
    if (out.viewmat) {
        std::fill_n(out.viewmat, 16, 0.0f);
        fetch({{&camera_, out.viewmat, 12 * sizeof(float)}});
    }
}
