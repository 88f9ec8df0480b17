// Thread pool: parallel_for.
#include "parallel.h"

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif
#if !defined(_WIN32)
#include <pthread.h>
#endif

namespace gs {
namespace {

// Subnormals slow the blend loops down a hundredfold and are negligible there. The state of the host process, for
// example Blender, is restored.
class FlushSubnormals {
  public:
#if defined(__x86_64__) || defined(_M_X64)
    FlushSubnormals() : saved_(_mm_getcsr()) { _mm_setcsr(kDefault | kFlushToZero | kZeroInputs); }
    ~FlushSubnormals() { _mm_setcsr(saved_); }

  private:
    static constexpr unsigned kDefault = 0x1f80, kFlushToZero = 0x8000, kZeroInputs = 0x0040;
    unsigned saved_;
#elif defined(__aarch64__)
    FlushSubnormals() {
        __asm__ volatile("mrs %0, fpcr" : "=r"(saved_));
        const uint64_t flush = uint64_t(1) << 24;
        __asm__ volatile("msr fpcr, %0" ::"r"(flush));
    }
    ~FlushSubnormals() { __asm__ volatile("msr fpcr, %0" ::"r"(saved_)); }

  private:
    uint64_t saved_;
#endif
};

struct Job {
    const std::function<void(size_t, int)> *body = nullptr;
    size_t count = 0;
    std::atomic<size_t> next{0};
    int wanted = 0;  // maximum number of helpers
    int joined = 0;  // helpers that joined
    int running = 0; // helpers still inside

    void work(int worker) {
        const FlushSubnormals flush;
        for (size_t i = next++; i < count; i = next++)
            (*body)(i, worker);
    }
};

class Pool {
  public:
    ~Pool() {
        {
            const std::lock_guard lock(mutex_);
            closing_ = true;
        }
        wake_.notify_all();
        for (auto &t : threads_)
            t.join();
    }

    void run(Job &job) {
        // One job at a time; callers from several threads take turns.
        const std::lock_guard turn(turn_);
        {
            const std::lock_guard lock(mutex_);
            try {
                while (int(threads_.size()) < job.wanted)
                    threads_.emplace_back([this] { loop(); });
            } catch (const std::system_error &) {
                // No more threads available: continue with the present ones.
            }
            job_ = &job;
        }
        wake_.notify_all();
        job.work(0);
        std::unique_lock lock(mutex_);
        job_ = nullptr;
        idle_.wait(lock, [&] { return job.running == 0; });
    }

  private:
    void loop() {
        std::unique_lock lock(mutex_);
        while (true) {
            wake_.wait(lock, [&] { return closing_ || (job_ && job_->joined < job_->wanted); });
            if (closing_)
                return;
            Job &job = *job_;
            const int worker = ++job.joined;
            ++job.running;
            lock.unlock();
            job.work(worker);
            lock.lock();
            if (--job.running == 0)
                idle_.notify_all();
        }
    }

    std::mutex turn_, mutex_;
    std::condition_variable wake_, idle_;
    std::vector<std::thread> threads_;
    Job *job_ = nullptr;
    bool closing_ = false;
};

// Never destroyed: joining threads while the process exits deadlocks on some systems.
std::atomic<Pool *> current{nullptr};

#if !defined(_WIN32)
// A forked process has none of its parent's threads, and may inherit locks that stay locked for ever, so it creates its
// own pool and leaks the old one.
[[maybe_unused]] const int watches_forks = pthread_atfork(nullptr, nullptr, [] { current.store(nullptr); });
#endif

Pool &pool() {
    Pool *found = current.load();
    if (!found) {
        Pool *const made = new Pool;
        if (current.compare_exchange_strong(found, made))
            return *made;
        delete made; // another thread was faster
    }
    return *found;
}

} // namespace

void parallel_for(size_t count, int threads, const std::function<void(size_t, int)> &body) {
    Job job;
    job.body = &body;
    job.count = count;
    job.wanted = int(count < size_t(threads) ? count : size_t(threads)) - 1;
    if (job.wanted <= 0)
        job.work(0);
    else
        pool().run(job);
}

} // namespace gs
