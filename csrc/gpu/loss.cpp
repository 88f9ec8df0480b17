// Loss on a device: buffers, the order of its shaders, and the call that tests use.
#include "loss.h"
#include "blur.h"
#include "constants.h"
#include "exposure.h"
#include "gpu.h"

#include "gscore/loss.h"

#include <algorithm>
#include <bit>
#include <cstddef>

namespace gs {

namespace {

// Pixels whose derivatives, nine floats each, have 32-bit indices in shaders.
constexpr int64_t kMostPixels = kMostIndex / 9;

// Bytes that take as long as comparing a pixel with the photo, or the gradient there; and a pixel of a pass of the blur,
// and a tap there.
constexpr size_t kCompareBytes = 128, kBlurBytes = 24, kTapBytes = 4;
// Words of the most taps of a blur, two each: its line has two at each place, its axis one.
constexpr int kMostReach = int(GS_BLUR_REACH * 64), kTapWords = 2 * 3 * (2 * kMostReach + 1);

static_assert(GS_BLUR_MAX == 64 * 64);
static_assert(sizeof(gs_loss_frame) == 184 && sizeof(gs_gpu_loss_result) == 48);

} // namespace

size_t GpuLoss::derivative_bytes(int32_t width, int32_t height) {
    return 9 * size_t(width) * size_t(height) * sizeof(float);
}

void GpuLoss::ensure(Device &device, int32_t width, int32_t height) {
    const int64_t pixels = int64_t(width) * height;
    if (pixels > kMostPixels)
        throw_failure(GS_BAD_ARGUMENT, "a device compares pictures of at most %lld pixels, got %d x %d",
                      (long long)kMostPixels, width, height);
    const size_t tiles = size_t(ceil_div(width, GS_TILE)) * tile_rows(height), floats = size_t(pixels) * sizeof(float);
    device.ensure(block_, sizeof(gs_loss_frame));
    device.ensure(taps_, kTapWords * kWord);
    device.ensure(sums_, GS_LOSS_SUMS * tiles * sizeof(float));
    device.ensure(v_alpha_, floats);
    device.ensure(result_, sizeof(gs_gpu_loss_result));
}

void GpuLoss::free(Device &device) {
    each_buffer([&](DeviceBuffer &b) { device.free(b); });
}

// All words are sent, so that the commands of two blurs are the same.
void GpuLoss::record_taps(Device &device, const LossInput &in, gs_loss_frame &f) {
    uint32_t words[kTapWords] = {}, count = 0;
    const auto passes = blur_taps(in.blur);
    for (size_t pass = 0; pass < passes.size(); ++pass) {
        for (const BlurTap &tap : passes[pass]) {
            if (2 * count >= kTapWords)
                throw_failure(GS_INTERNAL, "a blur has more than %d taps", kTapWords / 2);
            words[2 * count] = uint32_t(tap.dx & 0xFFFF) | uint32_t(tap.dy) << 16;
            words[2 * count++ + 1] = std::bit_cast<uint32_t>(tap.weight);
        }
        tap_counts_[pass] = passes[pass].size();
        f.tap_ends[pass + 1] = count;
    }
    device.update(taps_, words, sizeof words);
}

void GpuLoss::record_input(Device &device, const LossInput &in) {
    if (checks_enabled())
        each_buffer([&](DeviceBuffer &b) { device.fill(b, b.bytes, kPoison); });
    gs_loss_frame f = {};
    f.rgb = in.rgb;
    // No address is null, because drivers may read ahead of a condition.
    f.alpha = in.alpha ? in.alpha : in.rgb;
    f.photo = in.photo;
    f.mask = in.mask ? in.mask : in.photo;
    f.derivatives = in.derivatives;
    f.sums = sums_.address;
    f.v_alpha = v_alpha_.address;
    f.result = result_.address;
    f.taps = taps_.address;
    f.width = uint32_t(in.width);
    f.height = uint32_t(in.height);
    f.tiles_x = tiles_x_ = uint32_t(ceil_div(in.width, GS_TILE));
    f.tiles = tiles_x_ * tile_rows(in.height);
    f.mask_mode = uint32_t(in.mask_mode);
    f.has_mask = in.mask != 0;
    f.has_gain = in.has_gain;
    f.has_alpha_terms = in.has_alpha_terms();
    f.fixed_background = in.fixed_background && in.has_gain;
    for (int c = 0; c < 3; ++c) {
        const ExposureCurve curve = exposure_curve(in.has_gain ? in.gain[c] : 1.0f);
        f.gain[c] = curve.gain;
        f.steep[c] = curve.steep;
        f.dark[c] = curve.dark;
    }
    std::copy_n(in.background, 3, f.background);
    f.ssim_weight = in.ssim_weight;
    f.mask_alpha = in.mask ? in.mask_alpha : 0;
    f.see_through = in.see_through;
    f.counted = in.counted;
    if (in.has_blur)
        record_taps(device, in, f);
    device.update(block_, &f, sizeof f);
}

std::vector<LossPart> GpuLoss::parts(const LossInput &in) const {
    std::vector<LossPart> found;
    const auto blur = [&](VkDeviceAddress from, VkDeviceAddress to, uint32_t add, uint32_t divide) {
        gs_loss_push p = push();
        p.from = from;
        p.to = to;
        p.add = add;
        p.divide = divide;
        const size_t more = divide == add ? 0 : tap_counts_[divide];
        found.push_back({Shader::kBlur, p, kBlurBytes + (tap_counts_[add] + more) * kTapBytes});
    };
    const VkDeviceAddress between = in.derivatives; // which are not there yet, or no longer needed
    if (in.has_blur) {
        blur(in.rgb, between, 0, 0);
        blur(between, in.rgb, 1, 1);
    }
    found.push_back({Shader::kLossCompare, push(), kCompareBytes});
    found.push_back({Shader::kLossGradient, push(), kCompareBytes});
    if (in.has_blur) {
        blur(in.rgb, in.rgb, GS_BLUR_NONE, 1);
        blur(in.rgb, between, 1, 0);
        blur(between, in.rgb, 0, GS_BLUR_NONE);
    }
    return found;
}

void GpuLoss::record_part(Device &device, const LossPart &part, uint32_t first_row, uint32_t rows) {
    gs_loss_push p = part.push;
    p.first_row = first_row;
    device.dispatch(part.shader, p, tiles_x_, rows);
}

void GpuLoss::record_result(Device &device) { device.dispatch(Shader::kLossResult, push(), 1); }

void GpuLoss::record(Device &device, const LossInput &in) {
    record_input(device, in);
    for (const LossPart &part : parts(in))
        record_part(device, part, 0, tile_rows(in.height));
    record_result(device);
}

} // namespace gs

using namespace gs;

void gs_gpu::loss(const gs_loss_args &args, const gs_gpu_loss_terms &terms, gs_gpu_loss_result &result, float *v_image,
                  float *v_alpha) {
    const size_t pixels = size_t(args.width) * size_t(args.height), floats = pixels * sizeof(float);
    GpuLoss work;
    DeviceBuffer rgb, alpha, photo, mask, derivatives;
    const auto free_all = [&] {
        work.free(device);
        for (DeviceBuffer *b : {&rgb, &alpha, &photo, &mask, &derivatives})
            device.free(*b);
    };
    const auto upload = [&](DeviceBuffer &to, const void *array, size_t bytes) {
        if (!array)
            return VkDeviceAddress(0);
        device.ensure(to, bytes);
        send({{&to, const_cast<void *>(array), bytes}});
        return to.address;
    };
    try {
        work.ensure(device, args.width, args.height);
        device.ensure(derivatives, GpuLoss::derivative_bytes(args.width, args.height));
        LossInput in = {};
        in.width = args.width;
        in.height = args.height;
        in.rgb = upload(rgb, args.image, 3 * floats);
        in.derivatives = derivatives.address;
        in.alpha = upload(alpha, terms.alpha, floats);
        in.photo = upload(photo, args.target, 3 * pixels);
        in.mask = upload(mask, args.mask, pixels);
        in.mask_mode = args.mask_mode;
        std::copy_n(args.background, 3, in.background);
        in.ssim_weight = args.ssim_weight;
        in.has_gain = args.gain != nullptr;
        if (args.gain)
            std::copy_n(args.gain, 3, in.gain);
        in.has_blur = terms.has_blur != 0;
        std::copy_n(terms.blur, 3, in.blur);
        in.fixed_background = terms.fixed_background != 0;
        in.mask_alpha = terms.mask_alpha;
        in.see_through = terms.see_through;
        in.counted = terms.counted;
        const uint32_t rows = GpuLoss::tile_rows(args.height);
        const uint32_t band = terms.rows_at_once ? uint32_t(terms.rows_at_once) : rows;
        const auto submit = [&](auto record) {
            device.begin();
            record();
            device.finish(nullptr);
        };
        if (band >= rows) {
            submit([&] { work.record(device, in); });
        } else {
            submit([&] { work.record_input(device, in); });
            for (const LossPart &part : work.parts(in))
                for (uint32_t row = 0; row < rows; row += band)
                    submit([&] { work.record_part(device, part, row, std::min(band, rows - row)); });
            submit([&] { work.record_result(device); });
        }
        DeviceBuffer found = work.result(), by_alpha = work.v_alpha();
        fetch({{&found, &result, sizeof result},
               {&rgb, v_image, v_image ? 3 * floats : 0},
               {&by_alpha, v_alpha, v_alpha && in.has_alpha_terms() ? floats : 0}});
        if (v_alpha && !in.has_alpha_terms())
            std::fill_n(v_alpha, pixels, 0.0f);
    } catch (...) {
        free_all();
        throw;
    }
    free_all();
}
