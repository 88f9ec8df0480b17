// Visible splats by depth.
#pragma once

#include "buffer.h"
#include "types.h"

namespace gs {

class DepthSort {
  public:
    // Slots of the visible splats, near to far; those of equal depth keep their order. What is returned stays until the
    // next call.
    const uint32_t *run(const uint32_t *keys, const int32_t *visible, const KeyRange *key_range, int64_t chunks,
                        size_t count, int threads);
    size_t bytes() const { return items_.bytes() + items_to_.bytes() + order_.bytes() + cursor_.bytes(); }

  private:
    struct Item {
        uint32_t key, slot;
    };

    // One stable pass by `bits` of the keys from bit `shift` on. `each(range, f)` calls f(key, slot) for the splats of a
    // range in their order; `put(at, key, slot)` writes one to its new place.
    template <class Each, class Put>
    void pass(int ranges, int shift, int bits, int threads, const Each &each, const Put &put);

    Buffer<Item> items_, items_to_;
    Buffer<uint32_t> order_, cursor_;
};

} // namespace gs
