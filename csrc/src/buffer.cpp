// Buffer allocation: aligned memory, on huge pages where the system has them.
#include "buffer.h"

#include <cstdint>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace {

#if defined(__linux__)
constexpr size_t kHugePage = size_t(2) << 20;

// Size of the mapping for an allocation.
size_t mapped_bytes(size_t bytes) {
    constexpr size_t page = size_t(64) << 10; // of any system
    return (bytes + page - 1) / page * page;
}
#endif

} // namespace

void *gs::allocate_pages(size_t bytes) {
#if defined(__linux__)
    // Mapped directly, because the C library takes blocks up to 32 MB from its heap, where growth leaves holes.
    if (bytes >= kHugePage) {
        const size_t size = mapped_bytes(bytes);
        void *const found = mmap(nullptr, size + kHugePage, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (found == MAP_FAILED)
            throw std::bad_alloc();
        char *const begin = static_cast<char *>(found);
        const size_t before = (kHugePage - reinterpret_cast<uintptr_t>(begin) % kHugePage) % kHugePage;
        if (before)
            munmap(begin, before);
        munmap(begin + before + size, kHugePage - before);
        // The last page only if the mapping covers it completely. If this fails, small pages are used.
        madvise(begin + before, bytes / kHugePage * kHugePage, MADV_HUGEPAGE);
        return begin + before;
    }
#endif
    return ::operator new(bytes, std::align_val_t(64));
}

void gs::free_pages(void *p, size_t bytes) {
#if defined(__linux__)
    if (bytes >= kHugePage) {
        munmap(p, mapped_bytes(bytes));
        return;
    }
#endif
    (void)bytes;
    ::operator delete(p, std::align_val_t(64));
}
