// The workspace behind gs_raster and the stages that fill it.
#pragma once

#include "types.h"

#include <cstdlib>
#include <memory>
#include <new>

namespace gs {

// Memory aligned to 64 bytes at least, large pieces on huge pages where the system has them: splats are looked up in no
// order of memory, and on small pages every other look-up waits for its address. Throws std::bad_alloc.
void *allocate_pages(size_t bytes);
void free_pages(void *p, size_t bytes);

// Uninitialised storage that only grows; contents are lost when it does.
template <class T> class Buffer {
  public:
    T *ensure(size_t count) {
        if (count > capacity_) {
            const size_t wanted = count + count / 4;
            data_.reset();
            capacity_ = 0;
            const size_t bytes = wanted * sizeof(T);
            data_ = {static_cast<T *>(allocate_pages(bytes)), Free{bytes}};
            capacity_ = wanted;
        }
        return data_.get();
    }
    T *get() const { return data_.get(); }
    size_t bytes() const { return capacity_ * sizeof(T); }

  private:
    struct Free {
        size_t bytes = 0;
        void operator()(T *p) const { free_pages(p, bytes); }
    };
    std::unique_ptr<T, Free> data_;
    size_t capacity_ = 0;
};

class GrowingInstances : public InstanceBuffer {
  public:
    GrowingInstances() : InstanceBuffer{nullptr, 0, 0, &GrowingInstances::grow_more, nullptr} {}
    ~GrowingInstances() { std::free(data); }
    GrowingInstances(const GrowingInstances &) = delete;
    GrowingInstances &operator=(const GrowingInstances &) = delete;

  private:
    static bool grow_more(InstanceBuffer *self);
};

} // namespace gs

struct gs_raster {
    gs_status forward(const gs_splats &, const gs_camera &, const gs_options &, const gs_image &);
    gs_status backward(const gs_splats &, const gs_image_grads &, const gs_splat_grads &,
                       const volatile int32_t *cancel);
    gs_status image_loss(const gs_loss_args &, gs_loss_result &, float *v_image);
    gs_status projected(float *means2d, float *depths, float *conics, float *colors, float *opacities) const;
    int64_t workspace_bytes() const;

    gs_stats stats = {};

  private:
    void sort_by_depth(size_t count, int threads);
    gs_status bin(const gs::BinArgs &, size_t count, uint32_t tiles, int threads);
    gs::ProjectArgs project_args(const gs_splats &) const;

    // State of the last forward call.
    bool valid_ = false;
    int64_t splat_count_ = 0;
    gs_camera camera_ = {};
    gs_options options_ = {};
    gs::BlendArgs blend_ = {};
    size_t entry_count_ = 0;

    // One chunk's worth of rows for each chunk of splats; visible ones are packed at its start.
    gs::Buffer<gs::Projected> projected_;
    gs::Buffer<uint32_t> depth_keys_;
    gs::Buffer<int32_t> visible_;
    gs::Buffer<uint32_t> moment_begin_, moment_count_;
    // Visible splats, near to far.
    gs::Buffer<uint32_t> order_, order_scratch_, keys_, keys_scratch_;
    // Splats times tiles.
    static constexpr int kMaxRanges = 64;
    gs::GrowingInstances instances_[kMaxRanges];
    gs::Buffer<uint32_t> tile_cursor_, tile_begin_;
    gs::Buffer<gs::Entry> entries_;
    gs::Buffer<gs::Moments> moments_;
    // Pixels, tile by tile.
    gs::Buffer<float> final_transmittance_;
    gs::Buffer<int32_t> stop_index_;
    gs::Buffer<double> viewmat_partial_;
    // The loss.
    gs::Buffer<float> loss_scratch_;
    gs::Buffer<double> loss_partial_;
};
