// Splats in training on a device: values, Adam moments, accumulated gradients and counters of all rows.
#pragma once

#include "gpu.h"
#include "model_push.h"

// Components of a row are numbered 4 * plane + k: means 0 to 2, opacity 3, quaternion 4 to 7, scales 8 to 10, sh0 12 to
// 14, shN from 15 on; 11 and those after the last coefficient are unused and zero in all tables. Calls that do not only
// record wait for the device; no commands of others may be in progress.
struct gs_gpu_model {
    // All tables but the values start as zeros.
    gs_gpu_model(gs_gpu *, const gs_splats &, const gs_splats *frozen, int32_t counter_count);
    ~gs_gpu_model();
    gs_gpu_model(const gs_gpu_model &) = delete;
    gs_gpu_model &operator=(const gs_gpu_model &) = delete;

    size_t rows() const { return size_t(splats.count); }
    size_t planes() const { return gs::planes_of(splats.sh_rest); }

    // Rows and components of a table GS_GPU_*: those of `list`, or where it is null `count` from `begin` on.
    struct Columns {
        int32_t table;
        uint32_t first, width;
        const int64_t *list;
        int64_t begin, count;
    };
    void read(const Columns &, float *out);
    void write(const Columns &, const float *values); // null: zeros
    // Grows the tables, so that a rebuild to so many rows needs no memory; the rows stay.
    void reserve(int64_t count);
    // Row i becomes the old row list[i], with zeros in all tables but the values where fresh[i] (may be null) is not 0.
    void rebuild(const int64_t *list, const uint8_t *fresh, int64_t count);
    void widen(int32_t sh_rest);
    int64_t clamp(double extent);
    void noise(float weight, const gs_random &);
    void morton_order(const int64_t *list, int64_t count, const float low[3], const float high[3], uint32_t *order);
    // Frees moments and accumulated gradients.
    void drop_moments();

    // Record into commands that are open. `words`: address of words, of which `run` decides whether rows are clamped (if
    // it is not 0), and `lost` is increased by the number of rows that were reset.
    void record_clamp(double extent, uint64_t words, uint32_t run, uint32_t lost);
    // Nothing moves if word `skip` is not 0; of `random`, rows and count are not used.
    void record_noise(float weight, const gs_random &random, uint64_t words, uint32_t skip);

    gs_gpu *gpu;
    gs_gpu_splats splats;              // its model: values [planes, rows] of four floats, as a draw reads them
    gs::DeviceBuffer moment1, moment2; // [planes, rows] of four floats
    gs::DeviceBuffer accumulated; // [planes - GS_PLANE_SH, rows] of four floats: gradients of shN that wait for its
                                  // step, in the layout of the SH planes; the components of sh0 are zero
    gs::DeviceBuffer counters;    // [counters, rows] floats
    int64_t frozen;               // rows in front that are drawn but never change; the API does not count them
    int32_t counter_count;
    bool has_moments = true; // false: nor accumulated gradients

  private:
    // [planes, rows] of `unit` floats each; `first` is the number of its first component.
    struct Table {
        gs::DeviceBuffer *buffer;
        size_t planes;
        uint32_t unit, first;
        size_t bytes(size_t rows) const { return planes * rows * unit * sizeof(float); }
    };
    static void check_size(int64_t count, int32_t sh_rest);
    Table table(int32_t number);
    template <class F> void each_table(F f);
    void grow(const Table &, size_t bytes);
    gs_rows_push push(const Table &, uint32_t first, uint32_t width, uint32_t count, uint32_t flags) const;
    void begin();
    void chunk(gs::Shader, const Columns &, int64_t at, int64_t count, const float *values, float *out);
    void clear_unused();
    void rebuild(const Table &, int32_t number, size_t count);
    void free_transit();
    void free_all();

    gs::DeviceBuffer list_, array_; // row numbers, and components of rows in transit
    gs::DeviceBuffer noise_;        // gs_noise
};
