// Forward and backward on hostile splats, views and options: no crash, and the results are as the header states.
#include "scene.h"

#include <limits>

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;
using fuzz::Scene;

namespace {

struct Drawn {
    Output rgb, alpha, inverse_depth, depth, median;
    std::vector<int32_t> radii;
    gs_status status;
    gs_stats stats = {};

    Drawn(gs_raster *raster, const Scene &s, size_t pixels)
        : rgb(3 * pixels), alpha(pixels), inverse_depth(pixels), depth(pixels), median(pixels), radii(s.size(), -1) {
        const gs_image image = {rgb.data(),   alpha.data(),  inverse_depth.data(),
                                depth.data(), median.data(), radii.data()};
        const gs_splats splats = s.splats();
        status = gs_raster_forward(raster, &splats, &s.view, &s.host, &image);
        REQUIRE(gs_raster_stats(raster, &stats) == GS_OK);
    }

    bool same_bits(const Drawn &o) const {
        return status == o.status && rgb.same_bits(o.rgb) && alpha.same_bits(o.alpha) &&
               inverse_depth.same_bits(o.inverse_depth) && depth.same_bits(o.depth) && median.same_bits(o.median) &&
               radii == o.radii;
    }
};

bool all_finite(const Output &values) {
    for (size_t i = 0; i < values.size(); ++i)
        if (!std::isfinite(values[i]))
            return false;
    return true;
}

void check_image(const Drawn &d, const Scene &s) {
    for (const Output *o : {&d.rgb, &d.alpha, &d.inverse_depth, &d.depth, &d.median})
        REQUIRE(o->guards_hold());
    if (d.status != GS_OK) {
        REQUIRE(d.status == GS_BAD_ARGUMENT || d.status == GS_TOO_MANY);
        REQUIRE(std::strlen(gs_last_error()) > 0);
        return;
    }
    const uint32_t asked = s.view.outputs;
    REQUIRE(d.rgb.all_written() && d.alpha.all_written());
    REQUIRE(all_finite(d.rgb) && all_finite(d.alpha));
    for (size_t i = 0; i < d.alpha.size(); ++i)
        REQUIRE(d.alpha[i] >= 0 && d.alpha[i] <= 1.00001f);
    const bool wanted[] = {(asked & GS_OUT_INVERSE_DEPTH) != 0, (asked & GS_OUT_DEPTH) != 0,
                           (asked & GS_OUT_MEDIAN_DEPTH) != 0};
    const Output *depths[] = {&d.inverse_depth, &d.depth, &d.median};
    for (int i = 0; i < 3; ++i)
        if (wanted[i]) {
            REQUIRE(depths[i]->all_written() && all_finite(*depths[i]));
            for (size_t p = 0; p < depths[i]->size(); ++p)
                REQUIRE((*depths[i])[p] >= 0);
        }
    int64_t reached = 0;
    for (const int32_t r : d.radii) {
        REQUIRE(r >= 0);
        reached += r > 0;
    }
    const int64_t wide = GS_LIST_TILE_WIDTH, high = GS_LIST_TILE_HEIGHT;
    const int64_t tiles = (s.view.width + wide - 1) / wide * ((s.view.height + high - 1) / high);
    REQUIRE(d.stats.visible == reached);
    REQUIRE(d.stats.entries >= 0 && d.stats.entries <= d.stats.visible * tiles);
    REQUIRE(d.stats.forward_pairs >= 0 && d.stats.forward_pairs <= d.stats.entries * wide * high);
}

struct Gradients {
    std::vector<Output> out; // means, quats, scales, opacities, sh0, shN, means2d, viewmat
    gs_status status;

    Gradients(gs_raster *raster, const Scene &s, const gs_image_grads &in, const int32_t *cancel) {
        const size_t n = s.size(), rest = size_t(std::max(s.sh_rest, 0));
        for (const size_t size : {3 * n, 4 * n, 3 * n, n, 3 * n, 3 * rest * n, 2 * n, size_t(16)})
            out.emplace_back(size);
        const gs_splat_grads g = {out[0].data(), out[1].data(), out[2].data(), out[3].data(),
                                  out[4].data(), out[5].data(), out[6].data(), out[7].data()};
        const gs_splats splats = s.splats();
        status = gs_raster_backward(raster, &splats, &in, &g, cancel);
        for (const Output &o : out)
            REQUIRE(o.guards_hold());
    }
};

void check_gradients(const Gradients &g, const Drawn &d, const Scene &s) {
    const size_t n = s.size();
    for (const Output &o : g.out)
        REQUIRE(o.all_written());
    for (size_t a = 0; a < 7; ++a) {
        const size_t width = n ? g.out[a].size() / n : 0;
        for (size_t i = 0; i < n * width; ++i)
            if (d.radii[i / width] == 0)
                REQUIRE(g.out[a][i] == 0);
    }
    if (s.tame)
        for (const Output &o : g.out)
            REQUIRE(all_finite(o));
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Scene scene = read_scene(in);
    const bool sane = scene.view.width > 0 && scene.view.height > 0;
    const size_t pixels = sane ? size_t(scene.view.width) * size_t(scene.view.height) : 1;

    Noise noise{uint32_t(size)};
    std::vector<float> far_depths(size % 3 ? 0 : pixels);
    for (size_t i = 0; i < far_depths.size(); ++i)
        far_depths[i] = i % 11 ? noise(-1, 7) : std::numeric_limits<float>::quiet_NaN();
    scene.host.far_depths = size % 3 ? nullptr : far_depths.data();

    gs_raster *raster = nullptr;
    REQUIRE(gs_raster_create(&raster) == GS_OK);
    const Drawn drawn(raster, scene, pixels);
    check_image(drawn, scene);

    std::vector<float> v(6 * pixels);
    for (float &x : v)
        x = noise(-1, 1);
    const gs_image_grads grads = {v.data(), v.data() + 3 * pixels,
                                  scene.view.outputs & GS_OUT_INVERSE_DEPTH ? v.data() + 4 * pixels : nullptr,
                                  scene.view.outputs & GS_OUT_DEPTH ? v.data() + 5 * pixels : nullptr};
    const int32_t stop = 1;
    if (drawn.status == GS_OK && !scene.view.orthographic) {
        REQUIRE(Gradients(raster, scene, grads, &stop).status == GS_CANCELLED);
        const Gradients first(raster, scene, grads, nullptr);
        REQUIRE(first.status == GS_OK);
        check_gradients(first, drawn, scene);

        // The same bits with another number of threads in the same workspace.
        Scene other = scene;
        other.host.threads = scene.host.threads == 1 ? 3 : 1;
        REQUIRE(drawn.same_bits(Drawn(raster, other, pixels)));
        const Gradients second(raster, other, grads, nullptr);
        for (size_t a = 0; a < first.out.size(); ++a)
            REQUIRE(first.out[a].same_bits(second.out[a]));

        Output means2d(2 * scene.size()), depths(scene.size());
        REQUIRE(gs_raster_projected(raster, means2d.data(), depths.data(), nullptr, nullptr, nullptr) == GS_OK);
        REQUIRE(means2d.guards_hold() && means2d.all_written() && depths.guards_hold() && depths.all_written());
    } else {
        const gs_status s = Gradients(raster, scene, grads, nullptr).status;
        REQUIRE(s == GS_BAD_ARGUMENT || s == GS_UNSUPPORTED);
    }
    gs_raster_destroy(raster);
    return 0;
}
