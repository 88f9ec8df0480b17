// Buffer: memory that a workspace reuses between calls, on huge pages where the system has them.
#pragma once

#include <cstddef>
#include <memory>

namespace gs {

// Memory aligned to 64 bytes at least, large blocks on huge pages where the system has them: splats are accessed in
// random order, and with small pages every second access misses the TLB. Throws std::bad_alloc.
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

} // namespace gs
