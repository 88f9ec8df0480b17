// Splats in training on a device: values, Adam moments, accumulated gradients and counters of all rows.
#pragma once

#include "gpu.h"

// Components of a row are numbered 4 * plane + k: means 0 to 2, opacity 3, quaternion 4 to 7, scales 8 to 10, sh0 12 to
// 14, shN from 15 on; 11 and those after the last coefficient are unused and zero in all tables.
struct gs_gpu_model {
    // All tables but the values start as zeros.
    gs_gpu_model(gs_gpu *, const gs_splats &, const gs_splats *frozen, int32_t counter_count);
    ~gs_gpu_model();
    gs_gpu_model(const gs_gpu_model &) = delete;
    gs_gpu_model &operator=(const gs_gpu_model &) = delete;

    size_t rows() const { return size_t(splats.count); }
    size_t planes() const { return gs::planes_of(splats.sh_rest); }

    gs_gpu *gpu;
    gs_gpu_splats splats;              // its model: values [planes, rows] of four floats, as a draw reads them
    gs::DeviceBuffer moment1, moment2; // [planes, rows] of four floats
    gs::DeviceBuffer accumulated; // [planes - GS_PLANE_SH, rows] of four floats: gradients of shN that wait for its
                                  // step, in the layout of the SH planes; the components of sh0 are zero
    gs::DeviceBuffer counters;    // [counters, rows] floats
    int64_t frozen;               // rows in front that are drawn but never change; the API does not count them
    int32_t counter_count;

  private:
    static void check_size(int64_t count, int32_t sh_rest);
    void free_all();
};
