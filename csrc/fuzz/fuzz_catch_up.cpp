// Lazy Adam sync: rows visible to a camera are updated, previews change nothing, threads make no difference.
#include "adam_state.h"
#include "scene.h"

using fuzz::AdamState;
using fuzz::all_finite;
using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;
using fuzz::Scene;

namespace {

constexpr float kRate = 0.01f;

AdamState late_state(size_t rows, Bytes &in, Noise &noise) {
    AdamState s(rows, 1 + in.byte() % (rows > 1000 ? 5 : 45), noise);
    for (float &m : s.moment1)
        m = noise(-1, 1);
    for (float &m : s.moment2)
        m = noise(0, 1) < 0.1f ? 0.0f : noise(0, 1);
    for (uint8_t &pending : s.pending)
        pending = noise(0, 1) < 0.3f ? 0 : uint8_t(noise(0, GS_ADAM_PENDING_SIZE));
    for (size_t k = 1; k < s.factors.size(); ++k)
        s.factors[k] = s.factors[k - 1] + noise(0, 0.01f);
    return s;
}

bool same_row(const AdamState &a, const AdamState &b, size_t row) {
    const auto same = [&](const std::vector<float> &x, const std::vector<float> &y) {
        return std::memcmp(&x[row * a.width], &y[row * a.width], a.width * sizeof(float)) == 0;
    };
    return same(a.param, b.param) && same(a.moment1, b.moment1) && same(a.moment2, b.moment2) &&
           a.pending[row] == b.pending[row];
}

// Whether the camera is rigid and its numbers leave enough float32 precision for pixels: the bounds of splats on screen
// assume both.
bool is_usual(const gs_view &c) {
    for (const float v : {c.fx, c.fy, c.cx, c.cy})
        if (!(std::fabs(v) < 1e5f))
            return false;
    if (!(c.fx > 1e-2f && c.fy > 1e-2f))
        return false;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            double sum = 0;
            for (int k = 0; k < 3; ++k)
                sum += double(c.viewmat[4 * i + k]) * double(c.viewmat[4 * j + k]);
            if (!(std::fabs(sum - (i == j)) < 1e-4))
                return false;
        }
    return true;
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Noise noise(in.word());
    const int64_t step = 1 + int64_t(in.word() % 1000000);
    const int mode = in.byte() % 2 ? GS_ADAM_VISIBLE : GS_ADAM_WAIT;
    Bytes rest = in; // the width is drawn again below, when the number of rows is known
    (void)in.byte();
    const Scene scene = fuzz::read_scene(in);
    const size_t n = scene.size();
    const AdamState before = late_state(n, rest, noise);
    const gs_splats splats = scene.splats();
    const auto caught_up = [&](const gs_view *view, int threads, gs_status *status) {
        AdamState s = before;
        const gs_adam_tensor tensor = s.view(mode, kRate, step);
        *status = gs_adam_catch_up(&tensor, &splats, view, nullptr, threads);
        return s;
    };

    gs_status status;
    const AdamState all = caught_up(nullptr, 1, &status);
    REQUIRE(status == GS_OK && all_finite(all.param) && all_finite(all.moment1) && all_finite(all.moment2));
    for (size_t i = 0; i < n; ++i)
        REQUIRE(all.pending[i] == 0 && (before.pending[i] || same_row(all, before, i)));

    gs_raster *raster = nullptr;
    REQUIRE(gs_raster_create(&raster) == GS_OK);
    const bool sane = scene.view.width > 0 && scene.view.height > 0;
    const size_t pixels = sane ? size_t(scene.view.width) * size_t(scene.view.height) : 1;
    Output rgb(3 * pixels), alpha(pixels), inverse_depth(pixels), depth(pixels), median(pixels);
    std::vector<int32_t> radii(n);
    const gs_image image = {rgb.data(), alpha.data(), inverse_depth.data(), depth.data(), median.data(), radii.data()};
    const gs_status drawn = gs_raster_forward(raster, &splats, &scene.view, &scene.host, &image);
    gs_raster_destroy(raster);

    const AdamState seen = caught_up(&scene.view, 1, &status);
    if (status != GS_OK) {
        REQUIRE(status == GS_BAD_ARGUMENT || status == GS_UNSUPPORTED);
        REQUIRE(std::strlen(gs_last_error()) > 0 && equal(seen, before));
        REQUIRE(drawn != GS_OK || scene.view.orthographic);
        return 0;
    }
    for (size_t i = 0; i < n; ++i) {
        if (drawn == GS_OK && radii[i] > 0 && is_usual(scene.view))
            REQUIRE(seen.pending[i] == 0);
        REQUIRE(same_row(seen, before.pending[i] && seen.pending[i] ? before : all, i));
    }
    REQUIRE(equal(seen, caught_up(&scene.view, 3, &status)) && status == GS_OK);

    // With an output array: the same values, and nothing else changes.
    Output values(before.param.size());
    AdamState untouched = before;
    const gs_adam_tensor tensor = untouched.view(mode, kRate, step);
    REQUIRE(gs_adam_catch_up(&tensor, &splats, &scene.view, values.data(), 3) == GS_OK);
    REQUIRE(values.guards_hold() && values.all_written() && equal(untouched, before));
    REQUIRE(seen.param.empty() ||
            std::memcmp(values.data(), seen.param.data(), seen.param.size() * sizeof(float)) == 0);
    return 0;
}
