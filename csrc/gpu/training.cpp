// Training steps: recorded without waiting, several in flight.
#include "model.h"

#include <algorithm>
#include <cmath>
#include <cstring>

using namespace gs;

namespace {

constexpr size_t kCameraFloats = 12, kQuad = 4 * sizeof(float);
// Bytes of a row of a plane in an Adam step: values and moments, read and written.
constexpr size_t kLearnBytes = 6 * kQuad;
// 0.5f, the first number of a damaged picture.
constexpr uint32_t kHalf = 0x3F000000;

static_assert(GS_SH_OFF == GS_GPU_SH_OFF && GS_SH_ACCUMULATE == GS_GPU_SH_ACCUMULATE && GS_SH_STEP == GS_GPU_SH_STEP);
static_assert(GS_OUT_GRADIENTS == GS_GPU_GRADIENTS);

size_t whole(size_t bytes) { return (bytes + 15) / 16 * 16; }

// Where the parts of a step's upload begin.
struct UploadLayout {
    size_t photo, mask, tiles, end;
    explicit UploadLayout(const gs_gpu_step &s, size_t tile_words) {
        const size_t pixels = size_t(s.view.width) * size_t(s.view.height);
        photo = 0;
        mask = s.photo ? whole(3 * pixels) : 0;
        tiles = mask + (s.mask ? whole(pixels) : 0);
        end = tiles + whole(tile_words * kWord);
    }
};

// What a step writes for the host.
struct StepResult {
    uint32_t state[GS_STATE_WORDS];
    gs_gpu_loss_result loss;
    float camera[kCameraFloats];
};

// Constants of Adam, as csrc/src/adam.cpp.
float rate_of(float rate, int64_t step) {
    const double root = std::sqrt(-std::expm1(double(step) * std::log(GS_ADAM_BETA2)));
    return float(double(rate) * root / -std::expm1(double(step) * std::log(GS_ADAM_BETA1)));
}

float eps2_of(int64_t step) {
    const double eps = double(GS_ADAM_EPS);
    return float(eps * eps * -std::expm1(double(step) * std::log(GS_ADAM_BETA2)));
}

enum Parameter { kMeans, kQuats, kScales, kOpacities, kSh0, kShN };

} // namespace

LossInput gs_gpu::loss_input(const StepSlot &slot) const {
    const gs_gpu_step &s = slot.request;
    LossInput in = {};
    in.width = s.view.width;
    in.height = s.view.height;
    in.rgb = rgb_.address;
    in.derivatives = moments_.address; // which has its content later in a step
    in.alpha = alpha_.address;
    in.photo = image_of(s).address;
    in.mask = has_mask(s) ? mask_of(s).address : 0;
    in.mask_mode = has_mask(s) ? s.mask_mode : GS_MASK_NONE;
    std::copy_n(s.shown_background, 3, in.background);
    in.ssim_weight = s.ssim_weight;
    in.has_gain = s.has_gain;
    std::copy_n(s.gain, 3, in.gain);
    in.has_blur = s.has_blur;
    std::copy_n(s.blur, 3, in.blur);
    in.fixed_background = s.has_gain && in.mask_mode == GS_MASK_COMPOSITE;
    in.mask_alpha = s.mask_alpha;
    in.see_through = s.see_through;
    in.counted = s.counted;
    return in;
}

gs_step gs_gpu::step_block(const StepSlot &slot) const {
    const gs_gpu_step &s = slot.request;
    gs_gpu_model &model = *slot.model;
    gs_step b = blank_step();
    const auto set = [&](gs_vec4 &rate, gs_vec4 &eps2, int component, Parameter p) {
        if (s.steps[p] > 0) {
            rate[component] = rate_of(s.rates[p], s.steps[p]);
            eps2[component] = eps2_of(s.steps[p]);
        }
    };
    for (int k = 0; k < 4; ++k) {
        set(b.mean_rate, b.mean_eps2, k, k < 3 ? kMeans : kOpacities);
        set(b.quat_rate, b.quat_eps2, k, kQuats);
        set(b.scale_rate, b.scale_eps2, k, kScales);
        set(b.sh_rate, b.sh_eps2, k, k < 3 ? kSh0 : kShN);
    }
    const double rows = double(std::max<int64_t>(model.splats.count - model.frozen, 1));
    b.opacity_reg = float(double(s.opacity_reg) / rows);
    b.scale_reg = float(double(s.scale_reg) / (3 * rows));
    b.half_width = 0.5f * float(s.view.width);
    b.half_height = 0.5f * float(s.view.height);
    b.frozen = uint32_t(model.frozen);
    b.sh_planes = uint32_t(model.planes() - GS_PLANE_SH);
    b.sh_update = uint32_t(s.sh_update);
    b.observes = s.gradient_counter >= 0;
    b.learns_pose = s.learns_pose != 0;
    b.updates = s.updates != 0;
    b.term_is_sane = slot.term_is_sane;
    b.values = model.splats.model.address;
    b.moment1 = model.moment1.address;
    b.moment2 = model.moment2.address;
    b.accumulated = model.accumulated.address;
    const auto counter = [&](int32_t number) {
        return model.counters.address + uint64_t(number) * uint64_t(model.splats.count) * sizeof(float);
    };
    if (s.gradient_counter >= 0) {
        b.gradient_sums = counter(s.gradient_counter);
        b.views = counter(s.view_counter);
    }
    b.camera_parts = camera_parts_.address;
    b.camera = camera_.address;
    b.state = step_state_.address;
    b.sane = step_loss_.result().address;
    return b;
}

void gs_gpu::require_no_pause() const {
    for (const StepSlot &slot : slots_)
        if (slot.model && slot.paused)
            throw_failure(GS_BAD_ARGUMENT, "a step has paused: call gs_gpu_step_resume first");
}

// Makes room for a step, which waits for those in flight where a buffer grows, and sets the frame.
void gs_gpu::prepare_step(StepSlot &slot) {
    const gs_gpu_step &s = slot.request;
    const gs_gpu_model &model = *slot.model;
    const size_t pixels = size_t(s.view.width) * size_t(s.view.height), count = size_t(model.splats.count);
    drawn_ = nullptr;
    frame_.view = s.view;
    frame_.view.outputs |= GS_GPU_GRADIENTS;
    frame_.count = uint32_t(count);
    frame_.raw = 1;
    frame_.model = model.splats.model.address;
    frame_.drop_rate = s.drop_rate;
    frame_.seed_low = uint32_t(s.seed);
    frame_.seed_high = uint32_t(s.seed >> 32);
    frame_.step = s.number;
    frame_.stream = s.drop_stream;
    ensure_splats(count);
    ensure_picture(frame_.view, gs_host{});
    slot.tiles = choose_tiles(slot.tile_bytes.empty() ? nullptr : slot.tile_bytes.data());
    if (download_.bytes > kChunkBytes) // of a draw before the first step
        device.free(download_);
    ensure_entries(std::max<size_t>(count * 4, 1 << 12), GpuLoss::derivative_bytes(s.view.width, s.view.height));
    step_loss_.ensure(device, s.view.width, s.view.height);
    device.ensure(photo_, s.kept ? 0 : whole(3 * pixels));
    device.ensure(mask_, s.mask && !s.kept ? whole(pixels) : 0);
    device.ensure(v_alpha_more_, (s.pauses ? pixels : 0) * sizeof(float));
    device.ensure(camera_parts_, kCameraFloats * size_t(groups_of(int64_t(count), GS_GROUP)) * sizeof(float));
    device.ensure(camera_, kCameraFloats * sizeof(float));
    if (!step_state_.bytes) {
        device.ensure(step_state_, GS_STATE_WORDS * kWord);
        device.begin();
        device.fill(step_state_, step_state_.bytes, 0);
        device.finish(nullptr);
    }
    frame_.v_rgb = rgb_.address;
    frame_.v_alpha = step_loss_.v_alpha().address;
    frame_.v_inverse_depth = inverse_depth_.address; // which was fetched when it gets its gradient
    frame_.v_alpha_more = v_alpha_more_.address;
    device.ensure(slot.download, sizeof(StepResult), Place::kDownload);
}

// Records a step; up to the picture, if it pauses and the term is not there yet.
void gs_gpu::record_step(StepSlot &slot, int commands, bool with_term) {
    const gs_gpu_step &s = slot.request;
    gs_gpu_model &model = *slot.model;
    const size_t pixels = size_t(s.view.width) * size_t(s.view.height);
    const UploadLayout at(s, slot.tiles.size());
    device.begin(commands);
    paced_bytes_ = 0;
    if (!with_term && checks_enabled())
        record_poison();
    if (s.photo)
        device.copy(slot.upload, image_of(s), 3 * pixels, at.photo);
    if (s.mask)
        device.copy(slot.upload, mask_of(s), pixels, at.mask);
    device.copy(slot.upload, tiles_, slot.tiles.size() * kWord, at.tiles);
    const gs_step block = step_block(slot);
    device.update(frame_buffer_, &frame_, sizeof frame_);
    device.update(step_buffer_, &block, sizeof block);
    if (!with_term) {
        record_lists();
        record_blend();
        if (device.is_damaged())
            device.fill(rgb_, kWord, kHalf);
        if (s.pauses)
            return;
    }
    const LossInput loss = loss_input(slot);
    step_loss_.record_input(device, loss);
    for (const LossPart &part : step_loss_.parts(loss))
        record_rows(pixels * part.pixel_bytes, nullptr,
                    [&](uint32_t row, uint32_t rows) { step_loss_.record_part(device, part, row, rows); });
    step_loss_.record_result(device);
    device.dispatch(Shader::kDecide, push(0), 1);
    if (s.updates)
        model.record_clamp(double(s.extent), step_state_.address, GS_STATE_CLAMP, GS_STATE_LOST_ROWS);
    device.dispatch(Shader::kDecide, push(1), 1);
    record_blend_backward((loss.has_alpha_terms() ? GS_V_ALPHA : 0) | (slot.has_term_depth ? GS_V_DEPTH : 0) |
                          (slot.has_term_alpha ? GS_V_ALPHA_MORE : 0));
    const Groups groups(groups_of(model.splats.count, GS_GROUP));
    pace(model.rows() * model.planes() * kLearnBytes + most_entries() * GS_MOMENT_QUADS * kQuad);
    device.dispatch(Shader::kLearn, push(), groups.x, groups.y);
    if (s.learns_pose)
        device.dispatch(Shader::kCameraSum, push(), 1);
    if (s.noise > 0 && s.updates) {
        gs_random random = {};
        random.seed = s.seed;
        random.step = s.number;
        random.stream = s.noise_stream;
        model.record_noise(s.noise, random, step_state_.address, GS_STATE_SKIP);
    }
    device.copy(step_state_, slot.download, sizeof StepResult::state, 0, offsetof(StepResult, state));
    device.copy(step_loss_.result(), slot.download, sizeof StepResult::loss, 0, offsetof(StepResult, loss));
    if (s.learns_pose)
        device.copy(camera_, slot.download, sizeof StepResult::camera, 0, offsetof(StepResult, camera));
}

void gs_gpu::start_step(int number) {
    StepSlot &slot = slots_[number];
    prepare_step(slot);
    const UploadLayout at(slot.request, slot.tiles.size());
    std::memcpy(static_cast<char *>(slot.upload.mapped) + at.tiles, slot.tiles.data(), slot.tiles.size() * kWord);
    record_step(slot, 1 + number, false);
    device.submit();
}

void gs_gpu::request_step(gs_gpu_model &model, const gs_gpu_step &step, int number) {
    StepSlot &slot = slots_[number];
    if (slot.model)
        throw_failure(GS_BAD_ARGUMENT, "gs_gpu_step_request: the result of slot %d was not read", number);
    require_no_pause();
    if (step.number) // else it is no step of a training
        device.inject_fault(true);
    slot.request = step;
    slot.term_is_sane = true;
    slot.has_term_alpha = slot.has_term_depth = false;
    slot.paused = step.pauses;
    const size_t pixels = size_t(step.view.width) * size_t(step.view.height);
    const size_t tile_words =
        step.tiles ? size_t(groups_of(step.view.width, GS_TILE)) * groups_of(step.view.height, GS_TILE) : 0;
    const UploadLayout at(step, tile_words);
    device.ensure(slot.upload, at.end, Place::kUpload);
    char *const to = static_cast<char *>(slot.upload.mapped);
    if (step.photo)
        std::memcpy(to + at.photo, step.photo, 3 * pixels);
    if (step.mask)
        std::memcpy(to + at.mask, step.mask, pixels);
    slot.tile_bytes.assign(step.tiles, step.tiles + tile_words);
    slot.model = &model;
    try {
        start_step(number);
    } catch (...) {
        slot.model = nullptr;
        throw;
    }
    in_flight_.push_back(number);
    if (step.kept)
        step.kept->written = true;
}

void gs_gpu::read_step_picture(int number, float *inverse_depth, float *alpha) {
    StepSlot &slot = slots_[number];
    if (!slot.model || !slot.paused)
        throw_failure(GS_BAD_ARGUMENT, "gs_gpu_step_picture: slot %d has no step that pauses", number);
    const size_t bytes = size_t(slot.request.view.width) * size_t(slot.request.view.height) * sizeof(float);
    for (;;) {
        device.await(1 + number, nullptr);
        uint32_t counters[GS_COUNTERS];
        fetch({{&counters_, counters, sizeof counters}});
        if (!counters[GS_COUNT_OVERFLOW])
            break;
        ensure_entries(counters[GS_COUNT_OVERFLOW]);
        start_step(number);
    }
    fetch({{&inverse_depth_, inverse_depth, bytes}, {&alpha_, alpha, bytes}});
}

void gs_gpu::resume_step(int number, double value, const float *v_inverse_depth, const float *v_alpha) {
    StepSlot &slot = slots_[number];
    if (!slot.model || !slot.paused)
        throw_failure(GS_BAD_ARGUMENT, "gs_gpu_step_resume: slot %d has no step that pauses", number);
    const size_t bytes = size_t(slot.request.view.width) * size_t(slot.request.view.height) * sizeof(float);
    slot.term_is_sane = std::isfinite(value);
    slot.has_term_depth = v_inverse_depth;
    slot.has_term_alpha = v_alpha;
    send({{&inverse_depth_, const_cast<float *>(v_inverse_depth), v_inverse_depth ? bytes : 0},
          {&v_alpha_more_, const_cast<float *>(v_alpha), v_alpha ? bytes : 0}});
    record_step(slot, 1 + number, true);
    device.submit();
    slot.paused = false;
}

void gs_gpu::read_step(int number, gs_gpu_step_numbers &out) {
    StepSlot &slot = slots_[number];
    if (!slot.model || slot.paused || in_flight_.front() != number)
        throw_failure(GS_BAD_ARGUMENT, "gs_gpu_step_result: slot %d is not that of the first step in flight", number);
    StepResult found;
    for (;;) {
        device.await(1 + number, nullptr);
        std::memcpy(&found, slot.download.mapped, sizeof found);
        const size_t entries = found.state[GS_STATE_OVERFLOW];
        if (!entries)
            break;
        ensure_entries(entries); // waits for the steps behind, which have changed nothing
        device.begin();
        device.fill(step_state_, step_state_.bytes, 0);
        device.finish(nullptr);
        for (const int each : in_flight_)
            start_step(each);
    }
    in_flight_.erase(in_flight_.begin());
    slot.model = nullptr;
    out = {};
    out.loss = double(found.loss.loss);
    out.mse = double(found.loss.mse);
    for (int k = 0; k < 3; ++k)
        out.v_log_gain[k] = double(found.loss.v_log_gain[k]);
    if (slot.request.learns_pose)
        std::copy_n(found.camera, kCameraFloats, out.v_viewmat);
    out.bad_rows = found.state[GS_STATE_BAD_ROWS];
    out.lost_rows = found.state[GS_STATE_LOST_ROWS];
    out.visible = found.state[GS_STATE_VISIBLE];
    out.entries = found.state[GS_STATE_ENTRIES];
    out.skipped = found.state[GS_STATE_SKIP] != 0;
}

void gs_gpu::release_steps() {
    drawn_ = nullptr; // its buffers are freed
    for (StepSlot &slot : slots_) {
        slot.model = nullptr;
        device.free(slot.upload);
        device.free(slot.download);
    }
    in_flight_.clear();
    step_loss_.free(device);
    each_buffer([&](DeviceBuffer &b) { device.free(b); });
}
