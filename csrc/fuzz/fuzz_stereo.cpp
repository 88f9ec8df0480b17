// Stereo sweep and check on any warps and numbers: nothing is written beyond the arrays, results are as the header
// states,
// threads make no difference.
#include "scene.h"

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

namespace {

// A photo with a repeating pattern, so that windows match in several places.
std::vector<uint8_t> photo(size_t count, Noise &noise, bool flat) {
    std::vector<uint8_t> grey(count);
    for (size_t i = 0; i < count; ++i)
        grey[i] = flat ? 77 : i % 3 ? uint8_t(noise(0, 256)) : uint8_t(i * 31);
    return grey;
}

// Inverse depths around 1, some of them unknown.
std::vector<float> depth_map(size_t count, Noise &noise) {
    std::vector<float> map(count);
    for (float &v : map)
        v = noise(0, 1) < 0.1f ? 0.0f : noise(0.9f, 1.1f);
    return map;
}

// A camera moved sideways by `shift` px at inverse depth 1, a little turned.
gs_stereo_warp moved(float shift, Noise &noise) {
    gs_stereo_warp warp = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {shift, noise(-1, 1), 0}};
    for (float &v : warp.rotation)
        v += noise(-1e-3f, 1e-3f);
    return warp;
}

// Replaces a number of a warp.
void bend(gs_stereo_warp &warp, Bytes &in) {
    const uint8_t at = in.byte() % 12;
    (at < 9 ? warp.rotation[at] : warp.translation[at - 9]) = in.hostile();
}

bool refused(gs_status status) { return status == GS_BAD_ARGUMENT && std::strlen(gs_last_error()) > 0; }

// Sizes that fit the arrays or are too small.
void shrink(int32_t &side, uint8_t by) { side -= by % 8 == 7 ? 4000 : by % 8; }

struct Swept {
    Output inverse_depth, score, second_best, contrast;
    gs_status status;

    Swept(const gs_stereo_sweep_args &args, size_t pixels)
        : inverse_depth(pixels), score(pixels), second_best(pixels), contrast(pixels) {
        const gs_stereo_found found = {inverse_depth.data(), score.data(), second_best.data(), contrast.data()};
        status = gs_stereo_sweep(&args, &found);
        for (const Output *out : {&inverse_depth, &score, &second_best, &contrast})
            REQUIRE(out->guards_hold());
    }
    bool same_bits(const Swept &other) const {
        return inverse_depth.same_bits(other.inverse_depth) && score.same_bits(other.score) &&
               second_best.same_bits(other.second_best) && contrast.same_bits(other.contrast);
    }
};

void check_swept(const Swept &found, const gs_stereo_sweep_args &args) {
    for (int32_t y = 0; y < args.height; ++y)
        for (int32_t x = 0; x < args.width; ++x) {
            const size_t i = size_t(y) * size_t(args.width) + size_t(x);
            for (const Output *out : {&found.inverse_depth, &found.score, &found.second_best, &found.contrast})
                REQUIRE(out->written(i) && std::isfinite((*out)[i]));
            const float depth = found.inverse_depth[i], score = found.score[i], second_best = found.second_best[i];
            const int32_t r = args.radius;
            const bool rim = x < r || y < r || x >= args.width - r || y >= args.height - r;
            if (rim || depth == 0)
                REQUIRE(depth == 0 && score == -1 && second_best == -1);
            else
                REQUIRE(depth >= args.farthest && depth <= args.nearest && score > -1 && second_best >= -1);
            REQUIRE(score <= 1 && second_best <= 1);
            REQUIRE(found.contrast[i] >= 0 && found.contrast[i] <= 128);
        }
}

void sweep(Bytes &in, Noise &noise) {
    const int32_t width = 2 + in.byte() % 60, height = 2 + in.byte() % 60;
    const size_t pixels = size_t(width) * size_t(height);
    const uint8_t flags = in.byte(), plenty = in.byte();
    const std::vector<uint8_t> reference = photo(pixels, noise, flags & 1);
    std::vector<std::vector<uint8_t>> others;
    std::vector<gs_stereo_source> sources;
    for (int k = 1 + plenty % 4; k > 0; --k) {
        const int32_t w = 2 + in.byte() % 60, h = 2 + in.byte() % 60;
        others.push_back(flags & 2 ? reference : photo(size_t(w) * size_t(h), noise, flags & 4));
        sources.push_back(
            {flags & 2 ? width : w, flags & 2 ? height : h, others.back().data(), moved(noise(-9, 9), noise)});
    }
    gs_stereo_sweep_args args = {};
    args.width = width, args.height = height, args.grey = reference.data();
    args.source_count = int32_t(sources.size()), args.sources = sources.data();
    args.farthest = 0.5f, args.nearest = 2, args.planes = GS_STEREO_PLANES_MIN + plenty / 16;
    args.radius = 1 + (flags >> 3) % 3, args.best = 1 + (flags >> 5 & 1), args.noise = 1.5f;
    args.threads = 1 + (flags >> 6);
    for (int left = in.byte() % 6; left > 0; --left) {
        float *const numbers[] = {&args.farthest, &args.nearest, &args.noise};
        int32_t *const counts[] = {&args.planes, &args.radius, &args.best, &args.threads, &args.source_count};
        gs_stereo_source &source = sources[in.byte() % sources.size()];
        const uint8_t what = in.byte(), by = in.byte();
        if (what < 150)
            bend(source.warp, in);
        else if (what < 200)
            *numbers[what % 3] = in.hostile();
        else if (what < 230) // at most the number of sources
            *counts[what % 5] = what % 5 == 4 ? std::min(int32_t(by) - 3, args.source_count) : int32_t(by % 24) - 3;
        else
            shrink(what % 4 == 0   ? args.width
                   : what % 4 == 1 ? args.height
                   : what % 4 == 2 ? source.width
                                   : source.height,
                   by);
    }

    const Swept found(args, pixels);
    if (found.status != GS_OK) {
        REQUIRE(refused(found.status));
        return;
    }
    check_swept(found, args);
    args.threads = args.threads == 1 ? 4 : 1;
    const Swept again(args, pixels);
    REQUIRE(again.status == GS_OK && found.same_bits(again));
    const int32_t stop = 1;
    args.cancel = &stop;
    REQUIRE(Swept(args, pixels).status == GS_CANCELLED);
}

struct Checked {
    std::vector<uint8_t> agree, contradict;
    Output inverse_depth;
    gs_status status;

    // The counts have an extra byte, which must not change.
    Checked(const gs_stereo_check_args &args, size_t pixels)
        : agree(pixels + 1, 251), contradict(pixels + 1, 251), inverse_depth(pixels) {
        status = gs_stereo_check(&args, agree.data(), contradict.data(), inverse_depth.data());
        REQUIRE(inverse_depth.guards_hold() && agree.back() == 251 && contradict.back() == 251);
    }
};

void check_results(const Checked &found, const gs_stereo_check_args &args) {
    const size_t pixels = size_t(args.width) * size_t(args.height);
    for (size_t i = 0; i < pixels; ++i) {
        const float own = args.inverse_depth[i], mean = found.inverse_depth[i];
        // The library flushes subnormal numbers to zero.
        const bool known = own >= std::numeric_limits<float>::min() && std::isfinite(own);
        REQUIRE(found.inverse_depth.written(i));
        REQUIRE(int32_t(found.agree[i]) + found.contradict[i] <= (known ? args.neighbour_count : 0));
        if (!known)
            REQUIRE(mean == 0);
        else if (found.agree[i] == 0)
            REQUIRE(mean == own);
        else if (args.relative < 1 && own < 1e37f / 256) // else the sum may overflow float32, or any neighbour agrees
            REQUIRE(mean >= own * (1 - args.relative) * 0.999f && mean <= own * (1 + args.relative) * 1.001f);
    }
}

void check(Bytes &in, Noise &noise) {
    const int32_t width = 2 + in.byte() % 40, height = 2 + in.byte() % 40;
    const size_t pixels = size_t(width) * size_t(height);
    std::vector<float> own = depth_map(pixels, noise);
    std::vector<std::vector<float>> maps;
    std::vector<gs_stereo_neighbour> neighbours;
    const uint8_t some = in.byte();
    for (int k = some < 250 ? some % 5 : 255; k > 0; --k) {
        const int32_t w = 2 + int32_t(noise(0, 40)), h = 2 + int32_t(noise(0, 40));
        maps.push_back(depth_map(size_t(w) * size_t(h), noise));
        const float shift = noise(-5, 5);
        neighbours.push_back({w, h, maps.back().data(), moved(shift, noise), moved(-shift, noise)});
    }
    gs_stereo_check_args args = {};
    args.width = width, args.height = height, args.inverse_depth = own.data();
    args.neighbour_count = int32_t(neighbours.size()), args.neighbours = neighbours.data();
    args.pixels = 2, args.relative = 0.1f, args.passed = 0.05f;
    args.threads = 1 + some % 3;
    for (int left = in.byte() % 8; left > 0; --left) {
        float *const numbers[] = {&args.pixels, &args.relative, &args.passed};
        const uint8_t what = in.byte(), by = in.byte();
        const size_t pick = neighbours.empty() ? 0 : by % neighbours.size();
        if (what < 80)
            own[(by | size_t(in.byte()) << 8) % pixels] = in.hostile();
        else if (what < 200 && !neighbours.empty())
            bend(what % 2 ? neighbours[pick].warp : neighbours[pick].back, in);
        else if (what < 220 && !neighbours.empty())
            maps[pick][in.byte() % maps[pick].size()] = in.hostile();
        else if (what < 240)
            *numbers[what % 3] = in.hostile();
        else if (what < 248)
            args.neighbour_count = std::min(int32_t(by) - 9, args.neighbour_count);
        else
            shrink(what % 2 ? args.width : args.height, by);
    }

    const Checked found(args, pixels);
    if (found.status != GS_OK) {
        REQUIRE(refused(found.status));
        return;
    }
    check_results(found, args);
    args.threads = args.threads == 1 ? 4 : 1;
    const Checked again(args, pixels);
    REQUIRE(again.status == GS_OK && found.agree == again.agree && found.contradict == again.contradict);
    REQUIRE(found.inverse_depth.same_bits(again.inverse_depth));
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    fuzz::use_isa(in.byte());
    Noise noise(in.word());
    if (in.byte() % 2)
        sweep(in, noise);
    else
        check(in, noise);
    return 0;
}
