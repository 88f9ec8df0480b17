// Tests of the C interface without Python, for sanitizers and other machines: closed forms, invariances, hostile input.
#include "check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <random>

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

namespace {

struct Model {
    std::vector<float> means, quats, scales, opacities, sh0, shN;
    int sh_rest = 15, raw = 1;

    size_t size() const { return opacities.size(); }
    gs_splats splats() const {
        return {int64_t(size()), means.data(), quats.data(), scales.data(), opacities.data(), sh0.data(),
                shN.data(),      sh_rest,      raw};
    }
};

Model random_model(size_t n, unsigned seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<float> normal;
    std::uniform_real_distribution<float> uniform;
    Model m;
    for (size_t i = 0; i < n; ++i) {
        const float z = 1.5f + 4 * uniform(rng);
        m.means.insert(m.means.end(), {(uniform(rng) - 0.5f) * z, (uniform(rng) - 0.5f) * z, z});
        for (int k = 0; k < 4; ++k)
            m.quats.push_back(normal(rng));
        for (int k = 0; k < 3; ++k)
            m.scales.push_back(-3.5f + normal(rng));
        m.opacities.push_back(normal(rng));
        for (int k = 0; k < 3; ++k)
            m.sh0.push_back(normal(rng));
        for (int k = 0; k < 45; ++k)
            m.shN.push_back(0.1f * normal(rng));
    }
    return m;
}

gs_view make_view(int width, int height) {
    gs_view v = {};
    for (int i = 0; i < 4; ++i)
        v.viewmat[5 * i] = 1;
    v.fx = v.fy = 0.9f * float(width);
    v.cx = 0.5f * float(width) + 1.25f;
    v.cy = 0.5f * float(height) - 0.5f;
    v.width = width;
    v.height = height;
    v.near_plane = 0.01f;
    v.far_plane = 1e10f;
    v.eps2d = 0.3f;
    v.sh_degree = 3;
    v.background[0] = 0.2f;
    v.background[1] = 0.4f;
    v.background[2] = 0.6f;
    v.outputs = GS_OUT_INVERSE_DEPTH | GS_OUT_DEPTH | GS_OUT_MEDIAN_DEPTH;
    return v;
}

gs_host make_host(int threads = 1) {
    gs_host h = {};
    h.threads = threads;
    return h;
}

struct Result {
    gs_status forward = GS_OK, backward = GS_OK;
    std::vector<float> image; // rgb, alpha, inverse depth, depth, median
    std::vector<float> grads; // means, quats, scales, opacities, sh0, shN, means2d, viewmat
    gs_stats stats = {};

    bool finite() const {
        for (const auto *values : {&image, &grads})
            for (const float v : *values)
                if (!std::isfinite(v))
                    return false;
        return true;
    }
};

Result run(const Model &m, const gs_view &view, const gs_host &host) {
    Result r;
    const size_t pixels = size_t(view.width) * size_t(view.height), n = m.size();
    const float untouched = -777.0f;
    r.image.assign(7 * pixels, untouched);
    gs_image image = {};
    image.rgb = r.image.data();
    image.alpha = image.rgb + 3 * pixels;
    image.inverse_depth = image.alpha + pixels;
    image.depth = image.inverse_depth + pixels;
    image.median_depth = image.depth + pixels;
    gs_raster *raster = nullptr;
    CHECK(gs_raster_create(&raster) == GS_OK);
    const gs_splats splats = m.splats();
    r.forward = gs_raster_forward(raster, &splats, &view, &host, &image);
    if (r.forward == GS_OK) {
        std::vector<float> v(6 * pixels);
        std::mt19937 rng(7);
        std::normal_distribution<float> normal;
        for (float &x : v)
            x = normal(rng);
        const gs_image_grads in = {v.data(), v.data() + 3 * pixels, v.data() + 4 * pixels, v.data() + 5 * pixels};
        const size_t rest = size_t(m.sh_rest);
        const size_t sizes[] = {3 * n, 4 * n, 3 * n, n, 3 * n, 3 * rest * n, 2 * n, 16};
        size_t total = 0;
        for (const size_t s : sizes)
            total += s;
        r.grads.assign(total, untouched);
        float *at[8], *next = r.grads.data();
        for (int i = 0; i < 8; ++i) {
            at[i] = next;
            next += sizes[i];
        }
        const gs_splat_grads out = {at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7], 0};
        const int32_t stop = 1;
        CHECK(gs_raster_backward(raster, &splats, &in, &out, &stop) ==
              (view.orthographic ? GS_UNSUPPORTED : GS_CANCELLED));
        r.backward = gs_raster_backward(raster, &splats, &in, &out, nullptr);
        CHECK(gs_raster_stats(raster, &r.stats) == GS_OK);
        for (const float x : r.image)
            CHECK(x != untouched);
        for (const float x : r.grads)
            CHECK((x != untouched) == (r.backward == GS_OK));
    }
    gs_raster_destroy(raster);
    return r;
}

double mean_alpha(const Result &r, const gs_view &c) {
    const size_t pixels = size_t(c.width) * size_t(c.height);
    double sum = 0;
    for (size_t i = 0; i < pixels; ++i)
        sum += double(r.image[3 * pixels + i]);
    return sum / double(pixels);
}

// Oracle: the alpha of one round splat at the pixel under its centre is its opacity.
void one_splat_has_its_closed_form() {
    Model m;
    m.means = {0, 0, 2};
    m.quats = {1, 0, 0, 0};
    m.scales = {0.1f, 0.1f, 0.1f};
    m.opacities = {0.7f};
    m.sh0 = {1, 0, -1};
    m.sh_rest = 0;
    m.raw = 0;
    gs_view c = make_view(33, 33);
    c.sh_degree = 0;
    c.cx = c.cy = 16.5f;
    const Result r = run(m, c, make_host());
    const size_t pixels = 33 * 33, center = 16 * 33 + 16;
    CHECK(std::fabs(r.image[3 * pixels + center] - 0.7f) < 1e-6f);
    CHECK(std::fabs(r.image[4 * pixels + center] - 0.35f) < 1e-6f);
    CHECK(std::fabs(r.image[5 * pixels + center] - 1.4f) < 1e-6f);
    CHECK(r.image[6 * pixels + center] == 2.0f);
    const float red = 0.7f * (0.5f + 0.28209479f) + 0.3f * 0.2f;
    CHECK(std::fabs(r.image[3 * center] - red) < 1e-6f);
    // Three pixels to the right: variance (fx * scale / z)^2 + eps2d.
    const double variance = std::pow(double(c.fx) * 0.1 / 2, 2) + 0.3;
    CHECK(std::fabs(double(r.image[3 * pixels + center + 3]) - 0.7 * std::exp(-9 / (2 * variance))) < 1e-6);
}

// Oracle: one thread.
void results_do_not_depend_on_threads() {
    const Model m = random_model(6000, 1);
    const gs_view c = make_view(150, 100);
    const Result one = run(m, c, make_host(1));
    CHECK(mean_alpha(one, c) > 0.1);
    for (const int threads : {2, 3, 5, 16, 64}) {
        const Result many = run(m, c, make_host(threads));
        CHECK(same_bits(one.image, many.image));
        CHECK(same_bits(one.grads, many.grads));
    }
}

// Oracle: the same pass without the skips.
void skips_do_not_change_a_bit() {
    for (unsigned seed = 0; seed < 8; ++seed) {
        Model m = random_model(1500, 10 + seed);
        if (seed % 2) // needles
            for (size_t i = 0; i < m.size(); ++i)
                m.scales[3 * i] += 3.0f;
        gs_view c = make_view(90 + int(seed) * 7, 70 + int(seed) * 3);
        gs_host o = make_host(2);
        c.outputs |= GS_COUNT_USEFUL;
        const Result fast = run(m, c, o);
        CHECK(mean_alpha(fast, c) > 0.1);
        CHECK(fast.stats.useful_pairs > c.width * c.height);
        const uint32_t all = GS_NO_EXACT_CULL | GS_NO_ZERO_TILE | GS_NO_OPACITY_EXTENT | GS_NO_ROW_RANGE;
        for (const uint32_t off :
             {uint32_t(GS_NO_EXACT_CULL), uint32_t(GS_NO_OPACITY_EXTENT), uint32_t(GS_NO_ROW_RANGE), all}) {
            o.disable = off;
            const Result full = run(m, c, o);
            CHECK(same_bits(fast.image, full.image));
            CHECK(same_bits(fast.grads, full.grads));
            CHECK(fast.stats.forward_pairs < full.stats.forward_pairs);
            CHECK(fast.stats.useful_pairs == full.stats.useful_pairs);
            CHECK(fast.stats.useful_pairs < fast.stats.forward_pairs);
        }
    }
}

// Oracle: the model without the broken row.
void poisoned_rows_do_not_touch_others() {
    const float bad[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                         -std::numeric_limits<float>::infinity(), std::numeric_limits<float>::max(),
                         -std::numeric_limits<float>::max()};
    const size_t n = 400, row = 200;
    const gs_view c = make_view(64, 48);
    Model clean = random_model(n, 3);
    clean.means[3 * row + 2] = -1; // culled
    const Result expected = run(clean, c, make_host());
    for (int field = 0; field < 6; ++field)
        for (const float value : bad) {
            Model m = clean;
            std::vector<float> *arrays[] = {&m.means, &m.quats, &m.scales, &m.opacities, &m.sh0, &m.shN};
            if (field != 0)
                m.means[3 * row + 2] = 3;
            std::vector<float> &a = *arrays[field];
            a[a.size() / n * row] = value;
            const Result r = run(m, c, make_host());
            CHECK(r.forward == GS_OK && r.backward == GS_OK);
            if (!std::isfinite(value)) {
                CHECK(same_bits(r.image, expected.image));
                CHECK(r.finite());
            }
        }
}

void odd_sizes_and_empty_models_work() {
    const int sizes[][2] = {{1, 1}, {1, 40}, {15, 17}, {16, 16}, {17, 33}, {300, 16}};
    for (const auto &size : sizes) {
        const gs_view c = make_view(size[0], size[1]);
        CHECK(run(random_model(300, 5), c, make_host(2)).finite());
        const Result empty = run(random_model(0, 5), c, make_host(2));
        CHECK(empty.backward == GS_OK && empty.image[0] == 0.2f && empty.finite());
    }
}

void extreme_values_stay_finite() {
    std::mt19937 rng(11);
    std::uniform_real_distribution<float> uniform(-1, 1);
    gs_view c = make_view(40, 30);
    for (int round = 0; round < 200; ++round) {
        Model m = random_model(60, unsigned(round));
        for (size_t i = 0; i < m.size(); ++i) {
            m.means[3 * i + 2] = std::pow(10.0f, 4 * uniform(rng)) * (uniform(rng) > -0.8f ? 1.0f : -1.0f);
            for (int k = 0; k < 3; ++k)
                m.scales[3 * i + size_t(k)] = 40 * uniform(rng);
            m.opacities[i] = 100 * uniform(rng);
            if (round % 3 == 0)
                for (int k = 0; k < 4; ++k)
                    m.quats[4 * i + size_t(k)] *= std::pow(10.0f, 30 * uniform(rng));
        }
        c.antialias = round % 2;
        const Result r = run(m, c, make_host(2));
        CHECK(r.forward == GS_OK && r.backward == GS_OK);
        for (size_t i = 0; i < r.image.size(); ++i)
            if (!std::isfinite(r.image[i])) {
                std::printf("round %d: pixel value %zu is not finite\n", round, i);
                ++failures;
                break;
            }
    }
}

void bad_arguments_are_named() {
    const Model m = random_model(10, 1);
    gs_view c = make_view(20, 20);
    const gs_host o = make_host();
    c.width = 70000;
    CHECK(run(m, c, o).forward == GS_BAD_ARGUMENT);
    CHECK(std::strstr(gs_last_error(), "image size"));
    c = make_view(20, 20);
    c.fx = -1;
    CHECK(run(m, c, o).forward == GS_BAD_ARGUMENT);
    c = make_view(20, 20);
    c.eps2d = 0;
    CHECK(run(m, c, o).forward == GS_BAD_ARGUMENT);
    c = make_view(20, 20);
    c.sh_degree = 4;
    CHECK(run(m, c, o).forward == GS_BAD_ARGUMENT);
    CHECK(std::strstr(gs_last_error(), "sh_degree"));
    CHECK(gs_set_isa("vax") == GS_UNSUPPORTED);
    gs_raster *raster = nullptr;
    CHECK(gs_raster_create(&raster) == GS_OK);
    const gs_splats splats = m.splats();
    const gs_image_grads in = {};
    std::vector<float> g(64 * m.size());
    const gs_splat_grads out = {g.data(), g.data(), g.data(), g.data(), g.data(), g.data(), nullptr, nullptr, 0};
    CHECK(gs_raster_backward(raster, &splats, &in, &out, nullptr) == GS_BAD_ARGUMENT);
    gs_raster_destroy(raster);
}

// Oracle: the header. Runs before any other call with 0 threads, because a valid number is kept.
void the_environments_threads_are_checked() {
#if !defined(_WIN32)
    const char *const given = std::getenv("GSCORE_THREADS");
    const std::string before = given ? given : "";
    const Model m = random_model(10, 1);
    const gs_view c = make_view(20, 20);
    for (const char *text : {"many", "-2", "4x", "1e3", "0x4", " ", "1025", "99999999999999999999"}) {
        setenv("GSCORE_THREADS", text, 1);
        CHECK(gs_default_threads() == 0);
        CHECK(std::strstr(gs_last_error(), "GSCORE_THREADS") && std::strstr(gs_last_error(), text));
        CHECK(run(m, c, make_host(0)).forward == GS_BAD_ARGUMENT);
        CHECK(std::strstr(gs_last_error(), "GSCORE_THREADS"));
        CHECK(run(m, c, make_host(2)).forward == GS_OK);
    }
    setenv("GSCORE_THREADS", before.c_str(), 1);
    CHECK(gs_default_threads() >= 1);
    CHECK(run(m, c, make_host(0)).forward == GS_OK);
#endif
    for (const int threads : {-1, GS_THREADS_MAX + 1}) {
        CHECK(run(random_model(10, 1), make_view(20, 20), make_host(threads)).forward == GS_BAD_ARGUMENT);
        CHECK(std::strstr(gs_last_error(), "threads must be"));
    }
}

// Oracle: the header.
void parallel_rays_have_no_gradients() {
    const Model m = random_model(200, 4);
    gs_view c = make_view(40, 30);
    c.fx = c.fy = 10;
    c.orthographic = 1;
    const Result r = run(m, c, make_host());
    CHECK(r.forward == GS_OK && r.backward == GS_UNSUPPORTED);
    CHECK(std::strstr(gs_last_error(), "orthographic"));
    CHECK(mean_alpha(r, c) > 0.05);
    c.orthographic = 2;
    CHECK(run(m, c, make_host()).forward == GS_BAD_ARGUMENT);
}

// Oracle: the default state. A host may trap exceptions, keep or flush subnormals, and round as it likes.
void the_hosts_arithmetic_stays_its_own() {
#if defined(__x86_64__)
    const Model m = random_model(2000, 9);
    const gs_view c = make_view(64, 48);
    const Result expected = run(m, c, make_host(2));
    CHECK(mean_alpha(expected, c) > 0.1);
    const unsigned before = _mm_getcsr();
    // Traps for invalid, division by zero and overflow; subnormals flushed or not; rounding to zero.
    for (const unsigned state : {0x1f80u & ~0x0680u, 0x1f80u | 0x8040u, 0x1f80u | 0x6000u}) {
        _mm_setcsr(state);
        const Result found = run(m, c, make_host(2));
        const unsigned after = _mm_getcsr();
        _mm_setcsr(before);
        CHECK((after & ~0x3fu) == (state & ~0x3fu)); // except for status flags
        CHECK(same_bits(expected.image, found.image));
    }
#endif
}

// Oracle: the C library's, in double.
void exponentials_are_close() {
    std::vector<float> x, y;
    for (float v = -40; v <= 0; v += 0.00371f)
        x.push_back(v);
    y.resize(x.size());
    CHECK(gs_exp2(x.data(), y.data(), int64_t(x.size())) == GS_OK);
    double worst = 0;
    for (size_t i = 0; i < x.size(); ++i)
        worst = std::fmax(worst, std::fabs(double(y[i]) / std::exp2(double(x[i])) - 1));
    CHECK(worst > 0 && worst < 2.5e-7);
    CHECK(gs_exp2(nullptr, y.data(), 3) == GS_BAD_ARGUMENT);
}

void cancelling_stops() {
    const Model m = random_model(5000, 1);
    gs_host o = make_host(2);
    const int32_t cancel = 1;
    o.cancel = &cancel;
    CHECK(run(m, make_view(200, 200), o).forward == GS_CANCELLED);
}

// Oracle: central differences of the loss itself.
void loss_gradient_matches_differences() {
    const int w = 37, h = 70;
    std::mt19937 rng(3);
    std::uniform_real_distribution<float> uniform;
    std::vector<float> image(size_t(3 * w * h));
    std::vector<uint8_t> target(image.size()), mask(size_t(w * h));
    for (size_t i = 0; i < image.size(); ++i) {
        target[i] = uint8_t(255 * uniform(rng));
        // Away from the kink of |x - y|.
        image[i] = float(target[i]) / 255 + (uniform(rng) < 0.5f ? -0.1f : 0.1f);
    }
    for (auto &v : mask)
        v = uint8_t(128 + 127 * uniform(rng));
    gs_raster *raster = nullptr;
    CHECK(gs_raster_create(&raster) == GS_OK);
    for (int mode = 0; mode < 3; ++mode) {
        gs_loss_args args = {w, h, image.data(), target.data(), mask.data(), mode, {0.3f, 0.5f, 0.7f}, 0.2f, 2};
        std::vector<float> gradient(image.size(), -777.0f);
        gs_loss_result result = {}, plus = {}, minus = {};
        CHECK(gs_image_loss(raster, &args, &result, gradient.data()) == GS_OK);
        // Composited targets move towards the background, so the kink may be near: only smooth modes are compared.
        for (size_t i = 5; i < image.size() && mode != GS_MASK_COMPOSITE; i += 97) {
            const float kept = image[i], step = 1e-2f;
            image[i] = kept + step;
            CHECK(gs_image_loss(raster, &args, &plus, nullptr) == GS_OK);
            image[i] = kept - step;
            CHECK(gs_image_loss(raster, &args, &minus, nullptr) == GS_OK);
            image[i] = kept;
            const double difference = (plus.loss - minus.loss) / (2 * double(step));
            CHECK(std::fabs(difference - double(gradient[i])) < 2e-2 * std::fabs(difference) + 2e-6);
        }
        for (const float g : gradient)
            CHECK(g != -777.0f && std::isfinite(g));
    }
    std::vector<float> exact(image.size());
    for (size_t i = 0; i < exact.size(); ++i)
        exact[i] = float(target[i]) * (1.0f / 255.0f);
    gs_loss_args same = {w, h, exact.data(), target.data(), nullptr, GS_MASK_NONE, {0, 0, 0}, 0.2f, 1};
    gs_loss_result result = {};
    CHECK(gs_image_loss(raster, &same, &result, nullptr) == GS_OK);
    CHECK(result.loss == 0.0 && result.ssim == 1.0 && result.l1 == 0.0);
    gs_raster_destroy(raster);
}

// Oracle: <blur(a), b> = <a, adjoint(b)>; a flat picture stays flat; the variances of a dot.
void blurs_have_their_adjoint() {
    const int w = 41, h = 33;
    const size_t floats = size_t(3 * w * h);
    std::mt19937 rng(5);
    std::uniform_real_distribution<float> uniform;
    std::vector<float> a(floats), b(floats), blurred(floats, -777.0f), back(floats, -777.0f), again(floats);
    for (size_t i = 0; i < floats; ++i) {
        a[i] = uniform(rng);
        b[i] = uniform(rng);
    }
    const float covariances[][3] = {{0, 0, 0}, {4, 0, 4}, {9, 3, 2}, {2, -2.5f, 7}, {0, 0, 6}, {100, 60, 40}};
    for (const auto &c : covariances) {
        gs_blur_args args = {w, h, a.data(), {c[0], c[1], c[2]}, 0, 1};
        CHECK(gs_blur_image(&args, blurred.data()) == GS_OK);
        args.threads = 3;
        CHECK(gs_blur_image(&args, again.data()) == GS_OK && again == blurred);
        args.image = b.data();
        args.adjoint = 1;
        CHECK(gs_blur_image(&args, back.data()) == GS_OK);
        double forward = 0, backward = 0;
        for (size_t i = 0; i < floats; ++i) {
            forward += double(blurred[i]) * double(b[i]);
            backward += double(a[i]) * double(back[i]);
        }
        CHECK(std::fabs(forward - backward) < 1e-6 * forward);
        const std::vector<float> flat(floats, 0.5f);
        args = {w, h, flat.data(), {c[0], c[1], c[2]}, 0, 1};
        CHECK(gs_blur_image(&args, blurred.data()) == GS_OK);
        for (const float v : blurred)
            CHECK(std::fabs(v - 0.5f) < 1e-6f);
    }
    std::vector<float> dot(floats, 0.0f);
    dot[size_t(3 * (16 * w + 20))] = 1;
    gs_blur_args args = {w, h, dot.data(), {6, -3, 4}, 0, 1};
    CHECK(gs_blur_image(&args, blurred.data()) == GS_OK);
    double xx = 0, xy = 0, yy = 0;
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            const double v = double(blurred[size_t(3 * (y * w + x))]), dx = x - 20, dy = y - 16;
            xx += v * dx * dx;
            xy += v * dx * dy;
            yy += v * dy * dy;
        }
    CHECK(std::fabs(xx - 6) < 0.2 && std::fabs(xy + 3) < 0.2 && std::fabs(yy - 4) < 0.3);
    for (const auto &c : {std::array<float, 3>{-1, 0, 1}, {1, 2, 1}, {5000, 0, 1}, {1, NAN, 1}}) {
        args = {w, h, a.data(), {c[0], c[1], c[2]}, 0, 1};
        CHECK(gs_blur_image(&args, blurred.data()) == GS_BAD_ARGUMENT);
    }
    args = {w, h, a.data(), {1, 0, 1}, 0, 1};
    CHECK(gs_blur_image(&args, a.data()) == GS_BAD_ARGUMENT && gs_blur_image(nullptr, a.data()) == GS_BAD_ARGUMENT);
    args.width = 0;
    CHECK(gs_blur_image(&args, blurred.data()) == GS_BAD_ARGUMENT);
}

// Oracle: central differences of the loss; no gradient where photo and picture are white. A tenth of the picture is in
// the dark part of the curve, and a mask covers some pixels.
void gains_have_the_gradient_of_the_exposed_picture(int mask_mode) {
    const int w = 41, h = 53;
    std::mt19937 rng(4);
    std::uniform_real_distribution<float> uniform;
    std::vector<float> image(size_t(3 * w * h)), gradient(image.size(), -777.0f);
    std::vector<uint8_t> target(image.size()), mask(size_t(w * h));
    float gain[3] = {1.3f, 1, 0.6f};
    for (uint8_t &m : mask)
        m = uint8_t(uniform(rng) < 0.5f ? 255 : 60 + 190 * uniform(rng));
    for (size_t i = 0; i < image.size(); ++i) {
        const bool white = i % 11 == 0, dark = i % 11 == 5;
        if (white)
            mask[i / 3] = 255;
        target[i] = white ? 255 : uint8_t(40 + 170 * uniform(rng));
        // Away from the kink of |x - y|, from where white begins, and from where the lines of the curve meet.
        const float shift = uniform(rng) < 0.5f ? -0.1f : 0.1f;
        image[i] = dark ? 0.012f : (white ? 1.2f : std::max(0.09f, float(target[i]) / 255 + shift)) / gain[i % 3];
    }
    gs_raster *raster = nullptr;
    CHECK(gs_raster_create(&raster) == GS_OK);
    gs_loss_args args = {w, h, image.data(), target.data(), mask.data(), mask_mode, {}, 0.2f, 2, gain};
    gs_loss_result result = {};
    const auto loss = [&] {
        gs_loss_result found = {};
        CHECK(gs_image_loss(raster, &args, &found, nullptr) == GS_OK && found.v_log_gain[0] == 0);
        return found.loss;
    };
    const auto slope = [&](float &value, float by) {
        const float kept = value;
        value = kept + by;
        const double plus = loss();
        value = kept - by;
        const double minus = loss();
        value = kept;
        return (plus - minus) / (2 * double(by));
    };
    const auto close = [](double found, double wanted) {
        return std::fabs(found - wanted) < 2e-2 * std::fabs(wanted) + 2e-6;
    };
    CHECK(gs_image_loss(raster, &args, &result, gradient.data()) == GS_OK && result.loss == loss());
    for (size_t i = 0; i < image.size(); i += 11)
        CHECK(gradient[i] == 0);
    for (size_t i = 5; i < image.size(); i += 97)
        CHECK(close(double(gradient[i]), slope(image[i], 1e-2f)));
    for (size_t i = 5; i < image.size(); i += 121) // in the dark
        CHECK(close(double(gradient[i]), slope(image[i], 1e-2f)));
    for (int c = 0; c < 3; ++c)
        CHECK(close(result.v_log_gain[c], slope(gain[c], 1e-2f * gain[c]) * double(gain[c])));

    std::vector<float> again(image.size());
    gs_loss_result second = {};
    args.threads = 5;
    CHECK(gs_image_loss(raster, &args, &second, again.data()) == GS_OK && same_bits(gradient, again));
    CHECK(std::memcmp(&result, &second, sizeof result) == 0);
    for (const float bad : {0.0f, -1.0f, INFINITY, std::numeric_limits<float>::quiet_NaN()}) {
        gain[1] = bad;
        CHECK(gs_image_loss(raster, &args, &second, nullptr) == GS_BAD_ARGUMENT &&
              std::strstr(gs_last_error(), "gain"));
    }
    gs_raster_destroy(raster);
}

// A tensor under Adam; odd sizes, to cover the ends of vectors and chunks.
struct Learner {
    int64_t rows;
    int width;
    std::vector<float> param, grad, moment1, moment2;
    std::vector<uint8_t> visible, pending;
    std::vector<double> factors;

    Learner(int64_t n, int w)
        : rows(n), width(w), param(size_t(n * w), 1.0f), grad(size_t(n * w)), moment1(size_t(n * w)),
          moment2(size_t(n * w)), visible(size_t(n)), pending(size_t(n)), factors(GS_ADAM_PENDING_SIZE) {}

    gs_adam_tensor view(int mode, int64_t step) {
        return {param.data(), grad.data(), moment1.data(), moment2.data(), width,         mode,
                0.01f,        step,        visible.data(), pending.data(), factors.data()};
    }
};

// Runs 300 steps of two tensors, of which the second skips invisible rows; returns values, then bad rows.
std::vector<float> learn(int threads) {
    Learner all(2503, 3), late(2503, 9);
    std::mt19937 rng(5);
    std::normal_distribution<float> normal;
    std::vector<int32_t> radii(2503);
    int64_t bad = 0;
    for (int step = 1; step <= 300; ++step) {
        for (size_t row = 0; row < radii.size(); ++row) {
            radii[row] = row % 97 == 0 ? step == 1 : int32_t(rng() % 4 == 0);
            for (size_t k = 0; k < 3; ++k)
                all.grad[3 * row + k] = radii[row] ? normal(rng) : 0.0f;
            for (size_t k = 0; k < 9; ++k)
                late.grad[9 * row + k] = radii[row] ? normal(rng) : 0.0f;
        }
        if (step % 50 == 0)
            all.grad[size_t(step) * 7] = std::numeric_limits<float>::quiet_NaN();
        const gs_adam_tensor tensors[2] = {all.view(GS_ADAM_ALL, step), late.view(GS_ADAM_VISIBLE, step)};
        const gs_adam args = {2503, 2, tensors, radii.data(), threads};
        int64_t found = 0;
        CHECK(gs_adam_step(&args, &found) == GS_OK);
        bad += found;
    }
    std::vector<float> shown(late.param.size(), -777.0f);
    gs_splats splats = {};
    splats.count = 2503;
    const gs_adam_tensor tensor = late.view(GS_ADAM_VISIBLE, 300);
    CHECK(gs_adam_catch_up(&tensor, &splats, nullptr, shown.data(), threads) == GS_OK);
    CHECK(gs_adam_catch_up(&tensor, &splats, nullptr, nullptr, threads) == GS_OK);
    CHECK(same_bits(shown, late.param));
    for (const uint8_t l : late.pending)
        CHECK(l == 0);
    all.param.insert(all.param.end(), late.param.begin(), late.param.end());
    all.param.push_back(float(bad));
    return all.param;
}

void adam_skips_rows_for_any_number_of_threads() {
    const std::vector<float> one = learn(1);
    CHECK(one.back() == 6);
    for (const float v : one)
        CHECK(std::isfinite(v));
    for (const int threads : {2, 7, 64})
        CHECK(same_bits(one, learn(threads)));
    // A row that skipped a step gets the values of steps with zero gradients.
    Learner late(1, 1), dense(1, 1);
    for (int step = 1; step <= 600; ++step) {
        const int32_t radius = step <= 2 || step == 580;
        late.grad[0] = dense.grad[0] = radius ? 0.5f : 0.0f;
        for (Learner *x : {&late, &dense}) {
            const gs_adam_tensor tensor = x->view(x == &late ? GS_ADAM_VISIBLE : GS_ADAM_ALL, step);
            const gs_adam args = {1, 1, &tensor, &radius, 1};
            CHECK(gs_adam_step(&args, nullptr) == GS_OK);
        }
    }
    CHECK(late.pending[0] == 20);
    gs_splats splats = {};
    splats.count = 1;
    const gs_adam_tensor tensor = late.view(GS_ADAM_VISIBLE, 600);
    CHECK(gs_adam_catch_up(&tensor, &splats, nullptr, nullptr, 1) == GS_OK);
    CHECK(std::fabs(late.param[0] / dense.param[0] - 1) < 2e-6f);
    CHECK(std::fabs(dense.param[0] - 1) > 0.05f);
}

void adam_names_bad_arguments() {
    Learner x(4, 3);
    const auto step = [&](gs_adam_tensor t, int64_t count = 4, int threads = 0) {
        const gs_adam args = {count, 1, &t, nullptr, threads};
        return gs_adam_step(&args, nullptr);
    };
    gs_adam_tensor t = x.view(GS_ADAM_VISIBLE, 1);
    CHECK(step(t) == GS_OK);
    CHECK(step(t, -1) == GS_BAD_ARGUMENT);
    CHECK(step(t, 4, -1) == GS_BAD_ARGUMENT);
    CHECK(step(x.view(3, 1)) == GS_BAD_ARGUMENT);
    CHECK(step(x.view(GS_ADAM_ALL, 0)) == GS_BAD_ARGUMENT);
    t.pending = nullptr;
    CHECK(step(t) == GS_BAD_ARGUMENT);
    t = x.view(GS_ADAM_ALL, 1);
    t.lr = std::numeric_limits<float>::infinity();
    CHECK(step(t) == GS_BAD_ARGUMENT);
    t.lr = 0.1f;
    t.grad = nullptr;
    CHECK(step(t) == GS_BAD_ARGUMENT);
    CHECK(gs_adam_step(nullptr, nullptr) == GS_BAD_ARGUMENT);
    gs_splats splats = {};
    splats.count = 4;
    t = x.view(GS_ADAM_VISIBLE, 1);
    const gs_view view = make_view(8, 8);
    CHECK(gs_adam_catch_up(&t, &splats, &view, nullptr, 0) == GS_BAD_ARGUMENT); // without means
    CHECK(gs_adam_catch_up(&t, nullptr, nullptr, nullptr, 0) == GS_BAD_ARGUMENT);
    t.mode = GS_ADAM_ALL;
    CHECK(gs_adam_catch_up(&t, &splats, nullptr, nullptr, 0) == GS_BAD_ARGUMENT);
    CHECK(gs_add_screen_gradients(1, nullptr, nullptr, nullptr, nullptr, 1, 1, 0) == GS_BAD_ARGUMENT);
    CHECK(gs_add_screen_gradients(0, nullptr, nullptr, nullptr, nullptr, 1, 1, 0) == GS_OK);
}

void packing_names_bad_arguments() {
    float data[6] = {1, 2, 3, 4, 5, 6}, packed[4] = {};
    const int64_t places[3] = {1, 0, 2};
    gs_row_table table = {data, 3, 0, 2.0f};
    CHECK(gs_pack_rows(&table, 1, 2, places, packed, 1, 0) == GS_OK);
    CHECK(packed[1] == 2 && packed[2] == 2.5f && packed[3] == 3);
    CHECK(data[2] == 3 && data[3] == 2 && data[5] == 3); // divided where it was packed
    table.divisor = 1;
    CHECK(gs_pack_rows(&table, 1, 0, nullptr, nullptr, 0, 0) == GS_OK);
    CHECK(gs_pack_rows(nullptr, 1, 2, places, packed, 1, 0) == GS_BAD_ARGUMENT);
    CHECK(gs_pack_rows(&table, 0, 2, places, packed, 1, 0) == GS_BAD_ARGUMENT);
    CHECK(gs_pack_rows(&table, 1, 2, places, packed, 3, 0) == GS_BAD_ARGUMENT); // more rows than there are
    CHECK(gs_pack_rows(&table, 1, 2, nullptr, packed, 1, 0) == GS_BAD_ARGUMENT);
    CHECK(gs_pack_rows(&table, 1, 2, places, nullptr, 1, 0) == GS_BAD_ARGUMENT);
    CHECK(gs_pack_rows(&table, 1, 2, places, packed, 1, -1) == GS_BAD_ARGUMENT);
    CHECK(gs_pack_rows(&table, 1, 2, places + 2, packed, 1, 0) == GS_BAD_ARGUMENT); // row out of range
    table.divisor = 0;
    CHECK(gs_unpack_rows(&table, 1, 2, packed, nullptr, 1, 0) == GS_BAD_ARGUMENT);
    table = {data, 0, 0, 1.0f};
    CHECK(gs_unpack_rows(&table, 1, 2, packed, nullptr, 1, 0) == GS_BAD_ARGUMENT);
    table = {nullptr, 3, 0, 1.0f};
    CHECK(gs_unpack_rows(&table, 1, 2, packed, nullptr, 1, 0) == GS_BAD_ARGUMENT);
}

void random_numbers_are_those_of_every_instruction_set() {
    const uint32_t counter[4] = {0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, key[2] = {0xa4093822, 0x299f31d0};
    const uint32_t expected[4] = {0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}; // of Random123
    uint32_t words[4] = {};
    CHECK(gs_philox(counter, key, words) == GS_OK);
    CHECK(std::equal(words, words + 4, expected));
    std::vector<int64_t> rows(5001);
    for (size_t i = 0; i < rows.size(); ++i)
        rows[i] = int64_t(7 * i);
    const gs_random random = {3, 5, 1, rows.data(), int64_t(rows.size()), 2};
    std::vector<float> uniform(rows.size()), normal(3 * rows.size());
    CHECK(gs_random_uniform(&random, uniform.data()) == GS_OK && gs_random_normal(&random, normal.data()) == GS_OK);
    static const std::vector<float> first = normal; // of the first instruction set
    CHECK(std::memcmp(first.data(), normal.data(), normal.size() * sizeof(float)) == 0);
    for (const float u : uniform)
        CHECK(u >= 0 && u < 1);
    for (const float n : normal)
        CHECK(std::fabs(n) <= 5.768f);
    const gs_random single = {3, 5, 1, rows.data() + 4999, 1, 1};
    float alone[3] = {};
    CHECK(gs_random_normal(&single, alone) == GS_OK && std::equal(alone, alone + 3, &normal[3 * 4999]));
    const gs_random none = {3, 5, 1, nullptr, 0, 0}, negative = {3, 5, 1, nullptr, -1, 0};
    const gs_random many = {3, 5, 1, nullptr, 1, -1};
    CHECK(gs_random_uniform(&none, nullptr) == GS_OK);
    CHECK(gs_random_uniform(&negative, alone) == GS_BAD_ARGUMENT && gs_random_normal(&many, alone) == GS_BAD_ARGUMENT);
    CHECK(gs_random_normal(&single, nullptr) == GS_BAD_ARGUMENT && gs_random_normal(nullptr, alone) == GS_BAD_ARGUMENT);
    CHECK(gs_philox(nullptr, key, words) == GS_BAD_ARGUMENT);
}

} // namespace

int main() {
    CHECK(gs_abi_version() == GS_ABI_VERSION);
    the_environments_threads_are_checked();
    return on_every_isa([] {
        one_splat_has_its_closed_form();
        results_do_not_depend_on_threads();
        skips_do_not_change_a_bit();
        poisoned_rows_do_not_touch_others();
        odd_sizes_and_empty_models_work();
        extreme_values_stay_finite();
        bad_arguments_are_named();
        parallel_rays_have_no_gradients();
        cancelling_stops();
        the_hosts_arithmetic_stays_its_own();
        exponentials_are_close();
        loss_gradient_matches_differences();
        for (const int mode : {GS_MASK_NONE, GS_MASK_IGNORE})
            gains_have_the_gradient_of_the_exposed_picture(mode);
        blurs_have_their_adjoint();
        adam_skips_rows_for_any_number_of_threads();
        adam_names_bad_arguments();
        packing_names_bad_arguments();
        random_numbers_are_those_of_every_instruction_set();
    });
}
