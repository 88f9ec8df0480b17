// Drawing splats on a device.
#pragma once

#include "device.h"
#include "loss.h"
#include "screen_values.h"
#include "step.h"

#include <algorithm>
#include <functional>
#include <vector>

namespace gs {

// Number of planes of a model with `sh_rest` coefficients beyond the constant one, see frame.h.
constexpr size_t planes_of(int sh_rest) { return GS_PLANE_SH + size_t(3 * (1 + sh_rest) + 3) / 4; }

// Groups of `each` items.
inline uint32_t groups_of(int64_t items, int64_t each) { return uint32_t((items + each - 1) / each); }

// Groups of a dispatch of any number of workgroups, folded into rows of at most 65535.
struct Groups {
    uint32_t x, y;
    explicit Groups(int64_t count) : x(uint32_t(count < 65535 ? count : 65535)), y(groups_of(count, 65535)) {}
};

constexpr size_t kWord = sizeof(uint32_t);

// Bytes of a transfer at a time, so that the buffers for them stay small.
constexpr size_t kChunkBytes = size_t(8) << 20;

} // namespace gs

struct gs_gpu_splats {
    gs_gpu *gpu;
    gs::DeviceBuffer model;
    int64_t count;
    int32_t sh_rest, raw;
};

// A photo that stays on the device; a step that has its arrays too writes it.
struct gs_gpu_photo {
    gs_gpu *gpu;
    gs::DeviceBuffer image, mask;
    int32_t width, height;
    bool has_mask, written;
};

struct gs_gpu {
    explicit gs_gpu(VkPhysicalDevice physical) : device(physical) {}
    ~gs_gpu();

    void upload(const gs_splats &, gs_gpu_splats &);
    // Writes rows of a model from row `first` on; SH coefficients that they lack are zero.
    void write_rows(const gs_splats &, gs_gpu_splats &, size_t first);
    void release(gs_gpu_splats &);
    void draw(const gs_gpu_splats &, const gs_view &, const gs_host &, const gs_image &);
    void weights(const gs_gpu_splats &, const float *shares, float *sums);
    void backward(const gs_gpu_splats &, const gs_image_grads &, const gs_splat_grads &);
    void projected(const gs::ScreenValues &);
    // As gs_gpu_loss.
    void loss(const gs_loss_args &, const gs_gpu_loss_terms &, gs_gpu_loss_result &, float *v_image, float *v_alpha);
    void request_step(gs_gpu_model &, const gs_gpu_step &, int slot);
    void read_step_picture(int slot, float *inverse_depth, float *alpha);
    void resume_step(int slot, double value, const float *v_inverse_depth, const float *v_alpha);
    void read_step(int slot, gs_gpu_step_numbers &);
    void release_steps();
    void test(int kernel, const uint32_t *a, const uint32_t *b, uint32_t *out, int64_t count);

    gs::Device device;
    gs_gpu_stats stats = {};

  private:
    friend struct gs_gpu_model;
    // A step in flight, with what a repetition needs.
    struct StepSlot {
        gs_gpu_step request;
        gs_gpu_model *model;     // null: no step
        gs::DeviceBuffer upload; // photo, mask, tiles
        gs::DeviceBuffer download;
        std::vector<uint8_t> tile_bytes; // copy of request.tiles; the other arrays are in `upload`
        std::vector<uint32_t> tiles;     // words of it
        bool paused, term_is_sane, has_term_alpha, has_term_depth;
    };
    // Part of a device buffer, and the array that it is sent from or fetched to.
    struct Transfer {
        gs::DeviceBuffer *buffer;
        void *array;
        size_t bytes;
    };
    using Transfers = std::vector<Transfer>;

    void ensure_splats(size_t count);
    // Room for entries; `scratch`: bytes that `moments_` has at least.
    void ensure_entries(size_t count, size_t scratch = 0);
    void ensure_picture(const gs_view &, const gs_host &);
    // A submission of a draw: `begin`, commands, of which `lap` ends a part and adds it to a time, and `submit`, which
    // waits for them; throws GS_CANCELLED.
    void begin();
    void lap(double gs_gpu_stats::*time);
    void submit();
    // Starts another submission before a kernel that moves `bytes` if this one would become too long. A step waits for
    // none of them; else `time`, which may be null, has what came before.
    void pace(size_t bytes, double gs_gpu_stats::*time = nullptr);
    // Calls record(first row, rows) for bands of rows of tiles that submissions have time for; a kernel over all of them
    // takes as long as one that moves `bytes`.
    template <class F> void record_rows(size_t bytes, double gs_gpu_stats::*time, F record);
    // Entries of the last draw; while a step is recorded they are not known yet, and this is their upper bound.
    size_t most_entries() const;
    // Time of blending, forward or backward, as bytes that take as long.
    size_t blend_bytes(size_t of_entry) const;
    // Sorts pairs of buffers, of at most `most` keys, by the lowest bits; returns which of the two has the result.
    int sort(gs::DeviceBuffer *keys, gs::DeviceBuffer *values, uint32_t counter, size_t arguments, uint32_t bits,
             size_t most, double gs_gpu_stats::*time);
    // Sets the frame's tiles; returns the words that are to be sent to `tiles_`. Null: all are drawn.
    std::vector<uint32_t> choose_tiles(const uint8_t *tiles);
    // A step whose pointers all have some address, because drivers may read ahead of a condition.
    gs_step blank_step() const;
    gs_push push(uint32_t word0 = 0, uint32_t word1 = 0, uint32_t word2 = 0) const;
    void record_lists();
    void record_poison();
    void lists();
    void record_blend(double gs_gpu_stats::*time = nullptr);
    void record_blend_backward(uint32_t what); // bits GS_V_*
    Transfers pictures(const gs_image &);
    void send(const Transfers &);
    // Fetches in chunks; or in one piece, as commands of a submission that is open: record, finish, read.
    void fetch(const Transfers &);
    void record_fetch(const Transfers &);
    void read_fetched(const Transfers &);
    void each_buffer(const std::function<void(gs::DeviceBuffer &)> &);

    void require_no_pause() const; // throws where a step waits for its term, whose draw another would replace
    void prepare_step(StepSlot &);
    void record_step(StepSlot &, int commands, bool with_term);
    void start_step(int slot);
    static bool has_mask(const gs_gpu_step &s) { return s.mask || (s.kept && s.kept->has_mask); }
    const gs::DeviceBuffer &image_of(const gs_gpu_step &s) const { return s.kept ? s.kept->image : photo_; }
    const gs::DeviceBuffer &mask_of(const gs_gpu_step &s) const { return s.kept ? s.kept->mask : mask_; }
    gs::LossInput loss_input(const StepSlot &) const;
    gs_step step_block(const StepSlot &) const;

    StepSlot slots_[GS_GPU_STEPS_MAX] = {};
    std::vector<int> in_flight_; // slots in the order of their requests
    gs::GpuLoss step_loss_;
    gs::DeviceBuffer photo_, mask_, v_alpha_more_, step_state_; // the last is empty where there are no steps

    gs_frame frame_ = {};
    const gs_gpu_splats *drawn_ = nullptr;     // by the last draw, if it succeeded
    const volatile int32_t *cancel_ = nullptr; // of the draw
    std::vector<double gs_gpu_stats::*> laps_; // of this submission
    size_t paced_bytes_ = 0;                   // of this submission
    int sorted_entries_ = 0;                   // which pair of buffers has them
    gs::DeviceBuffer frame_buffer_, records_, keys_, tile_counts_, radii_, sums_, counters_;
    gs::DeviceBuffer visible_keys_[2], visible_rows_[2], offsets_;
    gs::DeviceBuffer entry_rows_, entry_keys_[2], entry_slots_[2], tile_ranges_;
    gs::DeviceBuffer tiles_, far_depths_, rgb_, alpha_, inverse_depth_, depth_, median_depth_;
    gs::DeviceBuffer shares_, entry_sums_, row_sums_;
    gs::DeviceBuffer transmittances_, stops_, row_entries_, moments_; // if the draw keeps what gradients need
    gs::DeviceBuffer v_rgb_, v_alpha_, v_inverse_depth_, step_buffer_;
    gs::DeviceBuffer gradients_, v_means2d_, camera_parts_, camera_;
    gs::DeviceBuffer upload_, download_;
};

template <class F> void gs_gpu::record_rows(size_t bytes, double gs_gpu_stats::*time, F record) {
    const uint32_t rows = frame_.tiles_y;
    const size_t bands = gs::checks_enabled() ? rows : std::min<size_t>(bytes / device.bytes_at_once() + 1, rows);
    const uint32_t band = gs::groups_of(rows, int64_t(bands));
    for (uint32_t row = 0; row < rows; row += band) {
        const uint32_t count = std::min(band, rows - row);
        pace(bytes / rows * count, time);
        record(row, count);
    }
}
