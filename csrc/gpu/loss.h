// Loss of a picture against its photo, and its gradients, on a device: L1, SSIM, gain, blur, masks, terms of opacity.
#pragma once

#include "device.h"
#include "loss_frame.h"

#include <vector>

namespace gs {

// What a loss depends on. Addresses are those of the device, multiples of 16.
struct LossInput {
    int32_t width, height;
    VkDeviceAddress rgb;         // [H, W, 3] float; the gradient in it takes its place
    VkDeviceAddress derivatives; // scratch of GpuLoss::derivative_bytes
    VkDeviceAddress alpha;       // [H, W] float; needed by `mask_alpha`, `see_through` and `fixed_background`
    VkDeviceAddress photo;       // [H, W, 3] bytes, in whole words
    VkDeviceAddress mask;        // [H, W] bytes, in whole words; 0: none
    int32_t mask_mode;           // GS_MASK_*; anything but GS_MASK_NONE needs a mask
    float background[3];         // RGB, for GS_MASK_COMPOSITE and `fixed_background`
    float ssim_weight;           // 0 to 1
    bool has_gain;               // else `gain` is not used
    float gain[3];               // above 0
    bool has_blur;               // else `blur` is not used
    float blur[3];               // as gs_blur_args.covariance
    bool fixed_background;       // the visible background is constant: the derivative in ln gain leaves it out
    float mask_alpha = 0;        // weight of the mean of |alpha - mask|; without a mask the term is 0
    float see_through = 0;       // weight of the mean of (1 - alpha) mask
    float counted = 1;           // share of unmasked pixels

    // Whether the loss has a gradient in opacity.
    bool has_alpha_terms() const { return (mask && mask_alpha != 0) || see_through != 0; }
};

// A kernel over all tiles, which may be split into ranges of rows of them.
struct LossPart {
    Shader shader;
    gs_loss_push push;
    size_t pixel_bytes; // bytes that take as long as a pixel
};

class GpuLoss {
  public:
    static size_t derivative_bytes(int32_t width, int32_t height);
    // Room for pictures of this size and smaller ones.
    void ensure(Device &, int32_t width, int32_t height);
    void free(Device &);

    // Records the whole loss into the open submission, without waiting; `ensure` was called before.
    void record(Device &, const LossInput &);
    // The same in one submission or several, in this order: the input, each of its parts over all rows, the result.
    // `parts` are those of the last input.
    void record_input(Device &, const LossInput &);
    std::vector<LossPart> parts(const LossInput &) const;
    void record_part(Device &, const LossPart &, uint32_t first_row, uint32_t rows);
    void record_result(Device &);
    static uint32_t tile_rows(int32_t height) { return uint32_t(height + GS_TILE - 1) / GS_TILE; }

    const DeviceBuffer &v_alpha() const { return v_alpha_; } // [H, W]; written if `has_alpha_terms`
    // A gs_gpu_loss_result; its first word is 1 if the loss is sane, the second 1 if it is not finite.
    const DeviceBuffer &result() const { return result_; }

  private:
    gs_loss_push push() const {
        return {block_.address, block_.address, block_.address, 0, GS_BLUR_NONE, GS_BLUR_NONE, 0};
    }
    void record_taps(Device &, const LossInput &, gs_loss_frame &);
    template <class F> void each_buffer(F f) {
        for (DeviceBuffer *b : {&block_, &taps_, &sums_, &v_alpha_, &result_})
            f(*b);
    }

    DeviceBuffer block_, taps_, sums_, v_alpha_, result_;
    uint32_t tiles_x_ = 0;                     // of the last input
    size_t tap_counts_[GS_BLUR_NONE + 1] = {}; // of the passes of its blur, and of none
};

} // namespace gs
