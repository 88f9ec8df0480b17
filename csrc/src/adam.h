// Adam over the rows of splats in training: driver interface and kernel arguments.
#pragma once

#include "types.h"

namespace gs {

// Maximum number of pending steps of a row: the limit of its counter, a byte.
constexpr int kMaxLag = GS_ADAM_LAGS - 1;
// Gradients are clamped to this, so that their squares stay finite.
constexpr float kGradientMax = 1e18f;

// Returns the number of rows whose gradients were not finite.
int64_t adam_step(const gs_adam &);
void adam_catch_up(const gs_adam_tensor &, const gs_splats &, const gs_camera *, float eps2d, float *out, int threads);

} // namespace gs
