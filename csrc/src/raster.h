// Rasterizer workspace behind gs_raster, and the stages that fill it.
#pragma once

#include "buffer.h"
#include "gscore/loss.h"
#include "raster_types.h"
#include "screen_values.h"
#include "tile_sort.h"

#include <memory>
#include <vector>

namespace gs {

class GrowingInstances : public InstanceBuffer {
  public:
    GrowingInstances() : InstanceBuffer{nullptr, 0, 0, &GrowingInstances::grow_more} {}
    ~GrowingInstances();
    GrowingInstances(const GrowingInstances &) = delete;
    GrowingInstances &operator=(const GrowingInstances &) = delete;

  private:
    static bool grow_more(InstanceBuffer *self);
};

} // namespace gs

struct gs_raster {
    gs_status forward(const gs_splats &, const gs_view &, const gs_host &, const gs_image &);
    gs_status backward(const gs_splats &, const gs_image_grads &, const gs_splat_grads &,
                       const volatile int32_t *cancel);
    gs_status image_loss(const gs_loss_args &, gs_loss_result &, float *v_image);
    gs_status projected(const gs::ScreenValues &) const;
    int64_t workspace_bytes() const;

    gs_stats stats = {};

  private:
    // The stages of a forward call in order; they poll the call's cancellation flag and return early if it is set.
    int64_t project(const gs_splats &, int32_t *radii); // returns the number of visible splats
    gs_status bin(const gs::BinArgs &, uint32_t tiles, int threads);
    void sort(uint32_t tiles);
    gs::PairCount blend(const gs_image &, uint32_t tiles);
    gs::ProjectArgs project_args(const gs_splats &) const;

    // State of the last forward call.
    bool valid_ = false;
    int64_t splat_count_ = 0;
    gs_view view_ = {};
    gs_host host_ = {};
    gs::BlendArgs blend_ = {};
    size_t entry_count_ = 0;

    // kChunk rows for each chunk of splats, with the visible ones packed at its start.
    gs::Buffer<gs::Projected> projected_;
    gs::Buffer<uint32_t> depth_keys_;
    gs::Buffer<int32_t> visible_;
    gs::Buffer<gs::Span> spans_;
    // Pairs of splat and tile: a list for each worker, and for each chunk the list that contains it.
    std::vector<std::unique_ptr<gs::GrowingInstances>> instances_;
    gs::Buffer<uint32_t> list_of_chunk_, moment_begin_;
    gs::Buffer<uint32_t> tile_cursor_, tile_begin_;
    gs::Buffer<gs::Entry> entries_;
    std::vector<gs::TileSort> sorts_; // of each worker
    gs::Buffer<gs::Moments> moments_;
    // Pixels, tile by tile.
    gs::Buffer<float> final_transmittance_;
    gs::Buffer<int32_t> stop_index_;
    gs::Buffer<double> viewmat_partial_;
    // The loss.
    gs::Buffer<float> loss_scratch_;
    gs::Buffer<double> loss_partial_;
};
