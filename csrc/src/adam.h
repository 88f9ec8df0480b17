// Adam over the rows of splats in training, with lazy rows that catch up later: interface, kernel arguments.
#pragma once

#include "gscore/optimizer.h"
#include "types.h"

namespace gs {

// Maximum number of pending steps of a row: the limit of its counter, a byte.
constexpr int kMaxPending = GS_ADAM_PENDING_SIZE - 1;
// Gradients are clamped to this, so that their squares stay finite.
constexpr float kGradientMax = 1e18f;

// Returns the number of rows whose gradients were not finite.
int64_t adam_step(const gs_adam &);
void adam_catch_up(const gs_adam_tensor &, const gs_splats &, const gs_view *, float *out, int threads);

// A tensor under Adam with the constants of its step.
struct AdamTensor {
    gs_adam_tensor t;
    float beta1, beta2, gain1, gain2;       // gain = 1 - beta
    float eps2;                             // eps^2 (1 - beta2^t): added to second moments without bias correction
    float rate;                             // lr sqrt(1 - beta2^t) / (1 - beta1^t)
    const float *factors, *decay1, *decay2; // [GS_ADAM_PENDING_SIZE] by number of pending steps
};

struct AdamArgs {
    int64_t rows;
    const AdamTensor *tensors;
    int count;
    const int32_t *radii; // [rows] or null
};

struct CatchUpArgs {
    const AdamTensor *tensor;
    const gs_splats *splats;
    const gs_view *view; // null: all rows
    float *out;          // [rows, width], or null: in place
};

} // namespace gs
