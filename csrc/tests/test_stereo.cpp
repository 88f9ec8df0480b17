// Tests of stereo in the C interface without Python, for sanitizers and other machines: closed forms, refusals.
#include "check.h"

#include <cmath>
#include <limits>
#include <random>

namespace {

constexpr int kWidth = 83, kHeight = 61, kRadius = 2;
constexpr size_t kPixels = size_t(kWidth) * size_t(kHeight);

// A wall parallel to both photos at inverse depth 1, shifted by `shift` px in the second camera.
gs_stereo_warp sideways(float shift) { return {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {shift, 0, 0}}; }

std::vector<uint8_t> texture(unsigned seed) {
    std::mt19937 rng(seed);
    std::vector<uint8_t> grey(kPixels);
    for (uint8_t &v : grey)
        v = uint8_t(rng());
    return grey;
}

// The shifted photo of the second camera; no data at its side.
std::vector<uint8_t> shifted(const std::vector<uint8_t> &grey, int shift) {
    std::vector<uint8_t> moved(kPixels);
    for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth - shift; ++x)
            moved[size_t(y * kWidth + x + shift)] = grey[size_t(y * kWidth + x)];
    return moved;
}

gs_stereo_sweep_args sweep_args(const uint8_t *grey, const std::vector<gs_stereo_source> &sources, int threads) {
    gs_stereo_sweep_args a = {};
    a.width = kWidth, a.height = kHeight, a.grey = grey;
    a.source_count = int32_t(sources.size()), a.sources = sources.data();
    a.farthest = 0.6f, a.nearest = 1.4f, a.planes = 17, a.radius = kRadius, a.best = 1, a.noise = 1,
    a.threads = threads;
    return a;
}

// Inverse depth, score, second_best, contrast.
std::vector<float> swept(const gs_stereo_sweep_args &args, gs_status wanted = GS_OK) {
    std::vector<float> out(4 * kPixels, -777.0f);
    const gs_stereo_found found = {&out[0], &out[kPixels], &out[2 * kPixels], &out[3 * kPixels]};
    CHECK(gs_stereo_sweep(&args, &found) == wanted);
    return out;
}

// Oracle: the shift between the photos.
void a_shifted_photo_has_the_depth_of_its_shift() {
    const int shift = 10;
    const std::vector<uint8_t> grey = texture(1), other = shifted(grey, shift), noise = texture(2);
    // The second source shows something else, like an occluded one.
    const std::vector<gs_stereo_source> sources = {{kWidth, kHeight, other.data(), sideways(float(shift))},
                                                   {kWidth, kHeight, noise.data(), sideways(3)}};
    gs_stereo_sweep_args args = sweep_args(grey.data(), sources, 1);
    const std::vector<float> found = swept(args);
    for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x) {
            const size_t i = size_t(y * kWidth + x);
            const bool rim = y < kRadius || y >= kHeight - kRadius || x < kRadius || x >= kWidth - kRadius;
            if (rim)
                CHECK(found[i] == 0 && found[kPixels + i] == -1 && found[2 * kPixels + i] == -1);
            else if (x < kWidth - shift - kRadius)
                CHECK(std::fabs(found[i] - 1) < 0.025f && found[kPixels + i] > 0.99f && found[kPixels + i] <= 1);
            CHECK(found[3 * kPixels + i] > 20 && found[3 * kPixels + i] < 128);
        }
    for (const int threads : {2, 3, 16}) {
        args.threads = threads;
        CHECK(same_bits(found, swept(args)));
    }
    // The mean over two sources, one of them occluded, is lower.
    args.best = 2;
    const std::vector<float> both = swept(args);
    const size_t middle = size_t(kHeight / 2 * kWidth + kWidth / 2);
    CHECK(both[kPixels + middle] < 0.95f);
    const int32_t stop = 1;
    args.cancel = &stop;
    (void)swept(args, GS_CANCELLED);
}

// Oracle: one surface common to all views, one farther away, one nearer.
void neighbours_agree_contradict_or_are_silent() {
    const int shift = 7;
    std::vector<float> own(kPixels, 1.0f), equal(kPixels, 1.004f), farther(kPixels, 0.5f), nearer(kPixels, 2.0f);
    own[5] = 0;
    own[6] = std::numeric_limits<float>::quiet_NaN();
    const auto neighbour = [&](const std::vector<float> &map) {
        return gs_stereo_neighbour{kWidth, kHeight, map.data(), sideways(float(shift)), sideways(float(-shift))};
    };
    const gs_stereo_neighbour neighbours[] = {neighbour(equal), neighbour(farther), neighbour(nearer)};
    gs_stereo_check_args args = {kWidth, kHeight, own.data(), 3, neighbours, 1, 0.01f, 0.05f, 1};
    std::vector<uint8_t> agree(kPixels), contradict(kPixels);
    std::vector<float> mean(kPixels), again(kPixels);
    CHECK(gs_stereo_check(&args, agree.data(), contradict.data(), mean.data()) == GS_OK);
    for (size_t i = 0; i < kPixels; ++i) {
        const bool known = i != 5 && i != 6, shared = int(i % kWidth) < kWidth - shift;
        CHECK(agree[i] == (known && shared) && contradict[i] == (known && shared));
        CHECK(std::fabs(mean[i] - (!known ? 0 : shared ? 1.002f : 1.0f)) < 1e-6f);
    }
    args.threads = 5;
    CHECK(gs_stereo_check(&args, agree.data(), contradict.data(), again.data()) == GS_OK);
    CHECK(same_bits(mean, again));
}

// Oracle: the header.
void bad_arguments_are_named() {
    const std::vector<uint8_t> grey = texture(1);
    const std::vector<gs_stereo_source> sources = {{kWidth, kHeight, grey.data(), sideways(1)}};
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const auto refuses = [&](const char *word, auto change) {
        gs_stereo_source source = sources[0];
        gs_stereo_sweep_args args = sweep_args(grey.data(), sources, 1);
        args.sources = &source;
        change(args, source);
        (void)swept(args, GS_BAD_ARGUMENT);
        CHECK(std::strstr(gs_last_error(), word));
    };
    refuses("reference", [](auto &a, auto &) { a.width = 1; });
    refuses("reference", [](auto &a, auto &) { a.height = GS_STEREO_SIDE_MAX + 1; });
    refuses("null", [](auto &a, auto &) { a.grey = nullptr; });
    refuses("null", [](auto &, auto &s) { s.grey = nullptr; });
    refuses("a source", [](auto &, auto &s) { s.width = 0; });
    refuses("finite", [&](auto &, auto &s) { s.warp.rotation[4] = nan; });
    refuses("finite", [&](auto &, auto &s) { s.warp.translation[0] = INFINITY; });
    refuses("sources", [](auto &a, auto &) { a.source_count = GS_STEREO_SOURCES_MAX + 1; });
    refuses("sources", [](auto &a, auto &) { a.source_count = 0; });
    refuses("inverse depths", [](auto &a, auto &) { a.nearest = a.farthest; });
    refuses("inverse depths", [&](auto &a, auto &) { a.farthest = nan; });
    refuses("planes", [](auto &a, auto &) { a.planes = GS_STEREO_PLANES_MIN - 1; });
    refuses("planes", [](auto &a, auto &) { a.planes = GS_STEREO_PLANES_MAX + 1; });
    refuses("radius", [](auto &a, auto &) { a.radius = GS_STEREO_RADIUS_MAX + 1; });
    refuses("best", [](auto &a, auto &) { a.best = 3; });
    refuses("noise", [](auto &a, auto &) { a.noise = 0; });
    refuses("threads", [](auto &a, auto &) { a.threads = -1; });
    CHECK(gs_stereo_sweep(nullptr, nullptr) == GS_BAD_ARGUMENT);

    const std::vector<float> map(kPixels, 1.0f);
    std::vector<uint8_t> agree(kPixels), contradict(kPixels);
    std::vector<float> mean(kPixels);
    const auto refuses_check = [&](const char *word, auto change) {
        gs_stereo_neighbour neighbour = {kWidth, kHeight, map.data(), sideways(1), sideways(-1)};
        gs_stereo_check_args args = {kWidth, kHeight, map.data(), 1, &neighbour, 1, 0.01f, 0.05f, 1};
        change(args, neighbour);
        CHECK(gs_stereo_check(&args, agree.data(), contradict.data(), mean.data()) == GS_BAD_ARGUMENT);
        CHECK(std::strstr(gs_last_error(), word));
    };
    refuses_check("reference", [](auto &a, auto &) { a.height = 0; });
    refuses_check("null", [](auto &a, auto &) { a.inverse_depth = nullptr; });
    refuses_check("null", [](auto &, auto &w) { w.inverse_depth = nullptr; });
    refuses_check("a neighbour", [](auto &, auto &w) { w.height = 1; });
    refuses_check("finite", [&](auto &, auto &w) { w.back.rotation[8] = nan; });
    refuses_check("neighbour_count", [](auto &a, auto &) { a.neighbour_count = 256; });
    refuses_check("neighbour_count", [](auto &a, auto &) { a.neighbour_count = -1; });
    refuses_check("negative", [&](auto &a, auto &) { a.relative = nan; });
    refuses_check("threads", [](auto &a, auto &) { a.threads = GS_THREADS_MAX + 1; });
}

} // namespace

int main() {
    return on_every_isa([] {
        a_shifted_photo_has_the_depth_of_its_shift();
        neighbours_agree_contradict_or_are_silent();
        bad_arguments_are_named();
    });
}
