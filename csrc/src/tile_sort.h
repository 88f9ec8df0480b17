// Tile sort: the list of a tile in order of depth.
#pragma once

#include "buffer.h"
#include "types.h"

namespace gs {

// Sorts lists one after the other; one for each thread.
class TileSort {
  public:
    // Takes the memory that `run` needs for lists up to this long; throws std::bad_alloc.
    void reserve(uint32_t longest);
    // By key; entries of the same key keep their order.
    void run(Entry *entries, uint32_t count);
    size_t bytes() const { return copy_.bytes() + items_.bytes() + by_low_.bytes(); }

  private:
    Buffer<Entry> copy_;
    Buffer<uint32_t> items_, by_low_;
};

} // namespace gs
