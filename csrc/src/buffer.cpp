#include "buffer.h"

#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace {

constexpr size_t kHugePage = size_t(2) << 20;

std::align_val_t alignment_of(size_t bytes) { return std::align_val_t(bytes < kHugePage ? 64 : kHugePage); }

} // namespace

void *gs::allocate_pages(size_t bytes) {
    void *const p = ::operator new(bytes, alignment_of(bytes));
#if defined(__linux__)
    // The last page only where it is ours to the end. Where this fails, small pages do.
    if (bytes >= kHugePage)
        madvise(p, bytes / kHugePage * kHugePage, MADV_HUGEPAGE);
#endif
    return p;
}

void gs::free_pages(void *p, size_t bytes) { ::operator delete(p, alignment_of(bytes)); }
