// Tests that a forked process can use the library, whatever its parent's threads were doing at the fork.
#include "gscore.h"

#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <thread>
#include <vector>

#include <sys/wait.h>
#include <unistd.h>

#if defined(__has_feature)
#if __has_feature(thread_sanitizer)
#define __SANITIZE_THREAD__ 1 // the macro of GCC
#endif
#endif

namespace {

constexpr int kWidth = 96, kHeight = 64, kForks = 40;
constexpr unsigned kPatience = 60; // timeout of a child in seconds, for milliseconds of work

struct Picture {
    std::vector<float> image, gradient;
    std::vector<uint8_t> target;

    Picture() : image(3 * kWidth * kHeight), gradient(image.size()), target(image.size()) {
        for (size_t i = 0; i < image.size(); ++i) {
            image[i] = float(i * 2654435761u % 1000) / 1000;
            target[i] = uint8_t(i * 40503u % 256);
        }
    }

    // Loss and gradient, by several threads; false if the library fails.
    bool work(int threads) {
        gs_loss_args args = {};
        args.width = kWidth;
        args.height = kHeight;
        args.image = image.data();
        args.target = target.data();
        args.ssim_weight = 0.2f;
        args.threads = threads;
        gs_loss_result result;
        gs_raster *raster = nullptr;
        const bool good =
            gs_raster_create(&raster) == GS_OK && gs_image_loss(raster, &args, &result, gradient.data()) == GS_OK;
        gs_raster_destroy(raster);
        return good;
    }
};

// Forks; returns whether the child computed `expected` in time.
bool child_agrees(const std::vector<float> &expected, int threads) {
    const pid_t child = fork();
    if (child == 0) {
        alarm(kPatience); // ends a child that hangs
        Picture own;
        const bool good = own.work(threads) && own.work(threads + 1);
        _exit(good && std::memcmp(own.gradient.data(), expected.data(), expected.size() * sizeof(float)) == 0 ? 0 : 1);
    }
    int status = 0;
    return child > 0 && waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

} // namespace

// Oracle: bits of the parent, and the clock.
int main() {
#if defined(__SANITIZE_THREAD__)
    std::printf("skipped: the thread sanitizer allows no threads after such a fork\n");
    return 0;
#endif
    int failures = 0;
    Picture expected;
    if (!expected.work(1) || !child_agrees(expected.gradient, 2)) {
        std::printf("FAILED: forked before there was a pool\n");
        ++failures;
    }
    if (!expected.work(3) || !child_agrees(expected.gradient, 2)) {
        std::printf("FAILED: forked after a call\n");
        ++failures;
    }
    std::atomic<bool> stop{false};
    std::thread busy([&] {
        Picture other;
        while (!stop)
            other.work(3);
    });
    for (int i = 0; i < kForks && failures == 0; ++i)
        if (!child_agrees(expected.gradient, 2)) {
            std::printf("FAILED: fork %d while another thread was at work\n", i);
            ++failures;
        }
    stop = true;
    busy.join();
    if (!expected.work(3)) {
        std::printf("FAILED: the parent after its forks\n");
        ++failures;
    }
    return failures == 0 ? 0 : 1;
}
