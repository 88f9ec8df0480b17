// Forward and backward on hostile splats, cameras and options: nothing crashes, and what comes out keeps its promises.
#include "bytes.h"
#include "gscore.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

namespace {

struct Scene {
    std::vector<float> means, quats, scales, opacities, sh0, shN;
    int sh_rest = 0, sh_degree = 0, raw = 1;
    gs_camera camera = {};
    gs_options options = {};
    bool tame = true; // no number was replaced by a hostile one

    size_t size() const { return opacities.size(); }
    gs_splats view() const {
        return {int64_t(size()), means.data(), quats.data(), scales.data(), opacities.data(),
                sh0.data(),      shN.data(),   sh_rest,      sh_degree,     raw};
    }
};

void use_isa(uint8_t pick) {
    static const std::vector<std::string> isas = [] {
        std::vector<std::string> found;
        std::stringstream list(gs_isas());
        for (std::string isa; std::getline(list, isa, ',');)
            found.push_back(isa);
        return found;
    }();
    REQUIRE(gs_set_isa(isas[pick % isas.size()].c_str()) == GS_OK);
}

// A scene in front of the camera, drawn from a seed; then single numbers of it are replaced.
Scene read_scene(Bytes &in) {
    Scene s;
    use_isa(in.byte());
    Noise noise(in.word());
    size_t n = in.byte();
    if (n > 200) // a few vectors more than one chunk of the library
        n = 1024 + (n - 200) * 37;
    const int degrees[] = {0, 3, 8, 15};
    const uint8_t shape = in.byte();
    s.sh_rest = degrees[shape & 3];
    s.sh_degree = std::min(int(shape >> 2 & 3), shape & 3);
    s.raw = shape >> 4 & 1;
    const bool needles = shape >> 5 & 1, wide = shape >> 6 & 1;
    for (size_t i = 0; i < n; ++i) {
        const float z = noise(0.5f, 6);
        for (const float v : {noise(-0.6f, 0.6f) * z, noise(-0.6f, 0.6f) * z, z})
            s.means.push_back(v);
        for (int k = 0; k < 4; ++k)
            s.quats.push_back(noise(-1, 1));
        for (int k = 0; k < 3; ++k) {
            const float log_scale = noise(-6, -1) + (needles && k == 0 ? 4.0f : 0.0f) + (wide ? 3.0f : 0.0f);
            s.scales.push_back(s.raw ? log_scale : std::exp(log_scale));
        }
        s.opacities.push_back(s.raw ? noise(-6, 8) : noise(0, 1));
        for (int k = 0; k < 3; ++k)
            s.sh0.push_back(noise(-2, 2));
        for (int k = 0; k < 3 * s.sh_rest; ++k)
            s.shN.push_back(noise(-0.5f, 0.5f));
    }

    gs_camera &c = s.camera;
    c.width = 1 + in.byte() % 70;
    c.height = 1 + in.byte() % 70;
    for (int i = 0; i < 4; ++i)
        c.viewmat[5 * i] = 1;
    c.fx = noise(0.5f, 1.5f) * float(c.width);
    c.fy = noise(0.5f, 1.5f) * float(c.height);
    c.cx = noise(0, 1) * float(c.width);
    c.cy = noise(0, 1) * float(c.height);
    c.near_plane = 0.01f;
    c.far_plane = 1e10f;

    gs_options &o = s.options;
    o.eps2d = 0.3f;
    const uint8_t flags = in.byte();
    o.outputs = flags & 7;
    o.antialias = flags >> 3 & 1;
    o.disable = flags >> 4 & 3;
    c.orthographic = flags >> 6 == 3;
    o.threads = 1 + (flags >> 6 & 1) * 2;

    std::vector<float> *arrays[] = {&s.means, &s.quats, &s.scales, &s.opacities, &s.sh0, &s.shN};
    float *cameras[] = {&c.fx, &c.fy, &c.cx, &c.cy, &c.near_plane, &c.far_plane};
    float *options[] = {&o.eps2d, &o.background[0], &o.background[1], &o.background[2]};
    while (!in.empty()) {
        const uint8_t what = in.byte();
        s.tame = false;
        if (what < 200) {
            std::vector<float> &a = *arrays[what % 6];
            const uint32_t at = in.byte() | uint32_t(in.byte()) << 8;
            const float value = in.hostile();
            if (!a.empty())
                a[at % a.size()] = value;
        } else if (what < 215) {
            const uint8_t at = in.byte();
            c.viewmat[at % 16] = in.hostile();
        } else if (what < 235) {
            *cameras[what % 6] = in.hostile();
        } else if (what < 245) {
            *options[what % 4] = in.hostile();
        } else if (what < 250) { // a whole splat twice, for ties
            const size_t from = in.byte(), to = in.byte();
            if (s.size())
                for (std::vector<float> *a : arrays) {
                    const size_t width = a->size() / s.size();
                    for (size_t k = 0; k < width; ++k)
                        (*a)[to % s.size() * width + k] = (*a)[from % s.size() * width + k];
                }
        } else {
            int32_t *const numbers[] = {&c.width, &c.height, &o.threads, &s.sh_degree, &c.orthographic, &s.sh_rest};
            // Small, so that what is accepted stays quick; the arrays hold what they hold, so sh_rest only shrinks.
            const int32_t value = int32_t(in.byte()) - 8;
            int32_t &number = *numbers[what % 6];
            number = &number == &s.sh_rest ? std::min(value, s.sh_rest) : &number == &o.threads ? value % 9 : value;
        }
    }
    return s;
}

struct Drawn {
    Output rgb, alpha, inverse_depth, depth, median;
    std::vector<int32_t> radii;
    gs_status status;
    gs_stats stats = {};

    Drawn(gs_raster *raster, const Scene &s, size_t pixels)
        : rgb(3 * pixels), alpha(pixels), inverse_depth(pixels), depth(pixels), median(pixels), radii(s.size(), -1) {
        const gs_image image = {rgb.data(), alpha.data(), inverse_depth.data(), depth.data(), median.data(), radii.data()};
        const gs_splats splats = s.view();
        status = gs_raster_forward(raster, &splats, &s.camera, &s.options, &image);
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
    const uint32_t asked = s.options.outputs;
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
    const int64_t tiles = int64_t((s.camera.width + GS_TILE - 1) / GS_TILE) * ((s.camera.height + GS_TILE - 1) / GS_TILE);
    REQUIRE(d.stats.visible == reached);
    REQUIRE(d.stats.entries >= 0 && d.stats.entries <= d.stats.visible * tiles);
    REQUIRE(d.stats.forward_pairs >= 0 && d.stats.forward_pairs <= d.stats.entries * GS_TILE * GS_TILE);
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
        const gs_splats splats = s.view();
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
    const bool sane = scene.camera.width > 0 && scene.camera.height > 0;
    const size_t pixels = sane ? size_t(scene.camera.width) * size_t(scene.camera.height) : 1;

    gs_raster *raster = nullptr;
    REQUIRE(gs_raster_create(&raster) == GS_OK);
    const Drawn drawn(raster, scene, pixels);
    check_image(drawn, scene);

    std::vector<float> v(6 * pixels);
    Noise noise{uint32_t(size)};
    for (float &x : v)
        x = noise(-1, 1);
    const gs_image_grads grads = {v.data(), v.data() + 3 * pixels,
                                  scene.options.outputs & GS_OUT_INVERSE_DEPTH ? v.data() + 4 * pixels : nullptr,
                                  scene.options.outputs & GS_OUT_DEPTH ? v.data() + 5 * pixels : nullptr};
    const int32_t stop = 1;
    if (drawn.status == GS_OK && !scene.camera.orthographic) {
        REQUIRE(Gradients(raster, scene, grads, &stop).status == GS_CANCELLED);
        const Gradients first(raster, scene, grads, nullptr);
        REQUIRE(first.status == GS_OK);
        check_gradients(first, drawn, scene);

        // Another number of threads, in the same workspace: the same bits.
        Scene other = scene;
        other.options.threads = scene.options.threads == 1 ? 3 : 1;
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
