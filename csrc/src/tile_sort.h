// Tile sort: the list of a tile in order of depth.
#pragma once

#include "buffer.h"
#include "raster_types.h"

namespace gs {

// Sorts the lists of a thread; one object per thread.
class TileSort {
  public:
    // Allocates memory for lists up to this length; throws std::bad_alloc.
    void reserve(uint32_t longest);
    // Sorts by key; entries with equal keys keep their order.
    void run(Entry *entries, uint32_t count);
    size_t bytes() const { return copy_.bytes() + items_.bytes() + by_low_.bytes(); }

  private:
    Buffer<Entry> copy_;
    Buffer<uint32_t> items_, by_low_;
};

} // namespace gs
