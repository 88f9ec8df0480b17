// Tests of the library for graphics cards in the C interface without Python, for sanitizers and other machines: the same
// pictures as the CPU's, refusals, failures. Without a device only the refusals are tested, unless GSCORE_GPU_REQUIRED=1.
#include "check.h"

#include "gscore_gpu.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <random>

namespace {

constexpr int kWidth = 50, kHeight = 37;
constexpr size_t kPixels = size_t(kWidth) * size_t(kHeight);

// Splats in front of a camera at the origin.
struct Scene {
    std::vector<float> means, quats, scales, opacities, sh0;
    explicit Scene(int count) {
        std::mt19937 random(5);
        const auto number = [&] { return float(random() % 20001) / 10000.0f - 1.0f; };
        for (int i = 0; i < count; ++i) {
            means.insert(means.end(), {number(), number(), 3 + number()});
            quats.insert(quats.end(), {1.5f + number(), number(), number(), number()});
            scales.insert(scales.end(), {-3 + number(), -3 + number(), -4});
            opacities.push_back(2 * number());
            sh0.insert(sh0.end(), {number(), number(), number()});
        }
    }
    gs_splats splats() const {
        return {int64_t(opacities.size()),
                means.data(),
                quats.data(),
                scales.data(),
                opacities.data(),
                sh0.data(),
                nullptr,
                0,
                1};
    }
};

gs_view view() {
    gs_view v = {};
    for (int i = 0; i < 16; i += 5)
        v.viewmat[i] = 1;
    v.fx = v.fy = 45;
    v.cx = kWidth / 2.0f;
    v.cy = kHeight / 2.0f;
    v.width = kWidth;
    v.height = kHeight;
    v.near_plane = 0.01f;
    v.far_plane = 100;
    v.eps2d = GS_EPS2D;
    v.outputs = GS_OUT_INVERSE_DEPTH;
    return v;
}

struct Picture {
    std::vector<float> rgb, alpha, inverse_depth;
    std::vector<int32_t> radii;
    explicit Picture(size_t count) : rgb(3 * kPixels), alpha(kPixels), inverse_depth(kPixels), radii(count) {}
    gs_image image() { return {rgb.data(), alpha.data(), inverse_depth.data(), nullptr, nullptr, radii.data()}; }
};

// Oracle: the CPU library; a pixel may differ more where rounding changes a comparison.
void pictures_are_those_of_the_cpu(gs_gpu *gpu) {
    const Scene scene(700);
    const gs_splats splats = scene.splats();
    const gs_view v = view();
    const gs_host host = {};
    Picture expected(700), found(700), again(700);
    gs_raster *raster = nullptr;
    CHECK(gs_raster_create(&raster) == GS_OK);
    const gs_image image = expected.image();
    CHECK(gs_raster_forward(raster, &splats, &v, &host, &image) == GS_OK);
    gs_raster_destroy(raster);
    gs_gpu_splats *uploaded = nullptr;
    CHECK(gs_gpu_upload(gpu, &splats, &uploaded) == GS_OK);
    for (Picture *p : {&found, &again}) {
        const gs_image to = p->image();
        CHECK(gs_gpu_draw(gpu, uploaded, &v, &host, &to) == GS_OK);
    }
    CHECK(same_bits(found.rgb, again.rgb) && same_bits(found.inverse_depth, again.inverse_depth));
    CHECK(found.radii == expected.radii);
    int different = 0;
    for (size_t i = 0; i < 3 * kPixels; ++i)
        different += !(std::fabs(found.rgb[i] - expected.rgb[i]) < 1e-5f);
    CHECK(different <= int(kPixels) / 200);
    CHECK(*std::max_element(found.alpha.begin(), found.alpha.end()) > 0.5f);
    // Sums of weights are alpha.
    std::vector<float> shares(3 * kPixels, 1.0f), sums(3 * 700);
    CHECK(gs_gpu_weights(gpu, uploaded, shares.data(), sums.data()) == GS_OK);
    double weights = 0, alphas = 0;
    for (size_t i = 0; i < sums.size(); i += 3)
        weights += double(sums[i]);
    for (const float a : found.alpha)
        alphas += double(a);
    CHECK(std::fabs(weights - alphas) < 1e-5 * alphas);
    gs_gpu_release(uploaded);
    CHECK(gs_gpu_projected(gpu, nullptr, nullptr, nullptr, nullptr, nullptr) == GS_BAD_ARGUMENT);
}

// Oracle: the CPU library; each picture needs larger lists than the one before, by a little or by much.
void lists_grow_with_the_pictures(gs_gpu *gpu) {
    const Scene scene(10000);
    const gs_splats splats = scene.splats();
    const gs_host host = {};
    gs_gpu_splats *uploaded = nullptr;
    CHECK(gs_gpu_upload(gpu, &splats, &uploaded) == GS_OK);
    gs_raster *raster = nullptr;
    CHECK(gs_raster_create(&raster) == GS_OK);
    int64_t most = 0;
    for (const float blur : {0.3f, 8.0f, 9.0f, 20.0f, 25.0f, 60.0f, 70.0f}) {
        gs_view v = view();
        v.eps2d = blur;
        Picture expected(10000), found(10000);
        const gs_image on_cpu = expected.image(), on_device = found.image();
        CHECK(gs_raster_forward(raster, &splats, &v, &host, &on_cpu) == GS_OK);
        CHECK(gs_gpu_draw(gpu, uploaded, &v, &host, &on_device) == GS_OK);
        int different = 0;
        for (size_t i = 0; i < 3 * kPixels; ++i)
            different += !(std::fabs(found.rgb[i] - expected.rgb[i]) < 1e-5f);
        CHECK(different <= int(kPixels) / 20);
        gs_gpu_stats stats;
        CHECK(gs_gpu_draw_stats(gpu, &stats) == GS_OK);
        most = std::max(most, stats.entries);
    }
    CHECK(most > 5 * 10000); // more than a draw expects at first
    gs_raster_destroy(raster);
    gs_gpu_release(uploaded);
}

void what_cannot_be_drawn_is_refused(gs_gpu *gpu) {
    const Scene scene(3);
    const gs_splats splats = scene.splats();
    gs_gpu_splats *uploaded = nullptr;
    CHECK(gs_gpu_upload(gpu, &splats, &uploaded) == GS_OK);
    const gs_host host = {};
    Picture picture(3);
    const gs_image image = picture.image();
    gs_view bad = view();
    bad.sh_degree = 1;
    CHECK(gs_gpu_draw(gpu, uploaded, &bad, &host, &image) == GS_BAD_ARGUMENT);
    bad = view();
    bad.width = 0;
    CHECK(gs_gpu_draw(gpu, uploaded, &bad, &host, &image) == GS_BAD_ARGUMENT);
    bad = view();
    bad.width = bad.height = 65536; // more pixels than a shader can number
    CHECK(gs_gpu_draw(gpu, uploaded, &bad, &host, &image) == GS_BAD_ARGUMENT);
    bad = view();
    bad.outputs = GS_OUT_DEPTH; // has no array
    CHECK(gs_gpu_draw(gpu, uploaded, &bad, &host, &image) == GS_BAD_ARGUMENT);
    CHECK(std::strlen(gs_gpu_last_error()) > 0);
    const int32_t cancel = 1;
    gs_host cancelled = {};
    cancelled.cancel = &cancel;
    const gs_view good = view();
    CHECK(gs_gpu_draw(gpu, uploaded, &good, &cancelled, &image) == GS_CANCELLED);
    CHECK(gs_gpu_draw(gpu, uploaded, &good, &host, &image) == GS_OK);
    gs_gpu_release(uploaded);
}

// Oracle: the rules of gs_gpu_model_create.
void models_are_created(gs_gpu *gpu) {
    const Scene scene(300), before(5);
    gs_splats splats = scene.splats(), frozen = before.splats();
    gs_gpu_model *model = nullptr;
    for (const gs_splats *f : std::initializer_list<const gs_splats *>{nullptr, &frozen}) {
        CHECK(gs_gpu_model_create(gpu, &splats, f, 3, &model) == GS_OK);
        gs_gpu_model_destroy(model);
    }
    CHECK(gs_gpu_model_create(gpu, &splats, nullptr, -1, &model) == GS_BAD_ARGUMENT);
    frozen.sh_rest = 3;
    frozen.shN = scene.means.data();
    CHECK(gs_gpu_model_create(gpu, &splats, &frozen, 0, &model) == GS_BAD_ARGUMENT);
    splats.raw = 0;
    CHECK(gs_gpu_model_create(gpu, &splats, nullptr, 0, &model) == GS_BAD_ARGUMENT);
}

// Oracle: refusals in place of reads from memory that was freed.
void freed_buffers_are_not_read(gs_gpu *gpu) {
    const Scene scene(300);
    const gs_splats splats = scene.splats();
    const gs_host host = {};
    gs_view v = view();
    v.outputs |= GS_GPU_GRADIENTS;
    Picture picture(300);
    const gs_image to = picture.image();
    std::vector<float> shares(3 * kPixels, 1.0f), sums(3 * 300);
    gs_gpu_model *model = nullptr;
    const gs_gpu_splats *drawn = nullptr;
    CHECK(gs_gpu_model_create(gpu, &splats, nullptr, 0, &model) == GS_OK);
    CHECK(gs_gpu_model_splats(model, &drawn) == GS_OK);
    for (const bool grows : {false, true}) {
        CHECK(gs_gpu_draw(gpu, drawn, &v, &host, &to) == GS_OK);
        CHECK((grows ? gs_gpu_model_reserve(model, 100000) : gs_gpu_steps_release(gpu)) == GS_OK);
        CHECK(gs_gpu_weights(gpu, drawn, shares.data(), sums.data()) == GS_BAD_ARGUMENT);
    }
    gs_gpu_model_destroy(model);
}

// Oracle: a refusal, also in a step that pauses, for 250,000 splats in most of 3969 tiles.
void too_many_entries_are_refused(gs_gpu *gpu) {
    Scene scene(250000);
    std::fill(scene.scales.begin(), scene.scales.end(), 3.0f);
    std::fill(scene.opacities.begin(), scene.opacities.end(), 3.0f);
    const gs_splats splats = scene.splats();
    gs_gpu_model *model = nullptr;
    CHECK(gs_gpu_model_create(gpu, &splats, nullptr, 0, &model) == GS_OK);
    gs_gpu_step step = {};
    step.view = view();
    step.view.width = step.view.height = 1000;
    std::vector<float> floats(3000000);
    std::vector<uint8_t> photo(3000000);
    step.photo = photo.data();
    step.counted = step.extent = 1;
    step.gradient_counter = step.view_counter = -1;
    step.pauses = 1;
    CHECK(gs_gpu_step_request(gpu, model, &step, 0) == GS_OK);
    CHECK(gs_gpu_step_request(gpu, model, &step, 1) == GS_BAD_ARGUMENT); // a paused step is lost else
    CHECK(gs_gpu_step_picture(gpu, 0, floats.data(), floats.data()) == GS_TOO_MANY);
    CHECK(gs_gpu_steps_release(gpu) == GS_OK);
    const gs_gpu_splats *drawn = nullptr;
    CHECK(gs_gpu_model_splats(model, &drawn) == GS_OK);
    const gs_host host = {};
    const gs_image to = {floats.data(), floats.data(), floats.data(), nullptr, nullptr, nullptr};
    CHECK(gs_gpu_draw(gpu, drawn, &step.view, &host, &to) == GS_TOO_MANY);
    gs_gpu_model_destroy(model);
}

// Oracles: refusals of photos without content, of another size or with another mask; the loss of a step that sends its
// photo; the bytes of the photo, counted.
void photos_stay(gs_gpu *gpu) {
    const Scene scene(300);
    const gs_splats splats = scene.splats();
    gs_gpu_model *model = nullptr;
    CHECK(gs_gpu_model_create(gpu, &splats, nullptr, 0, &model) == GS_OK);
    gs_gpu_step step = {};
    step.view = view();
    step.view.outputs = 0;
    const std::vector<uint8_t> photo(3 * kPixels, 100);
    step.photo = photo.data();
    step.counted = step.extent = 1;
    step.gradient_counter = step.view_counter = -1;
    const auto loss = [&] {
        gs_gpu_step_numbers found = {};
        CHECK(gs_gpu_step_request(gpu, model, &step, 0) == GS_OK);
        CHECK(gs_gpu_step_result(gpu, 0, &found) == GS_OK);
        return found.loss;
    };
    const double sent = loss();
    gs_gpu_memory before = {}, after = {};
    CHECK(gs_gpu_memory_use(gpu, &before) == GS_OK);
    gs_gpu_photo *kept = nullptr, *other = nullptr;
    CHECK(gs_gpu_photo_create(gpu, step.view.width, step.view.height, 0, &kept) == GS_OK);
    CHECK(gs_gpu_photo_create(gpu, step.view.width + 1, step.view.height, 0, &other) == GS_OK);
    CHECK(gs_gpu_memory_use(gpu, &after) == GS_OK);
    CHECK(after.in_use >= before.in_use + 6 * kPixels && after.peak >= after.in_use && after.limit > after.in_use);
    step.kept = other;
    CHECK(gs_gpu_step_request(gpu, model, &step, 0) == GS_BAD_ARGUMENT);
    step.kept = kept;
    step.photo = nullptr;
    CHECK(gs_gpu_step_request(gpu, model, &step, 0) == GS_BAD_ARGUMENT);
    step.photo = step.mask = photo.data();
    CHECK(gs_gpu_step_request(gpu, model, &step, 0) == GS_BAD_ARGUMENT);
    step.mask = nullptr;
    CHECK(loss() == sent);
    step.photo = nullptr;
    CHECK(loss() == sent);
    gs_gpu_photo_free(kept);
    gs_gpu_photo_free(other);
    gs_gpu_model_destroy(model);
}

void nulls_are_refused() {
    CHECK(gs_gpu_photo_create(nullptr, 1, 1, 0, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_memory_use(nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_loss(nullptr, nullptr, nullptr, nullptr, nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_create(nullptr, nullptr, nullptr, 0, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_splats(nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_read(nullptr, nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_write(nullptr, nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_reserve(nullptr, 1) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_rebuild(nullptr, nullptr, nullptr, 0) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_widen(nullptr, 3) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_clamp(nullptr, 1, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_noise(nullptr, 1, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_morton(nullptr, nullptr, 0, nullptr, nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_model_drop_moments(nullptr) == GS_BAD_ARGUMENT);
    gs_gpu_model_destroy(nullptr);
    CHECK(gs_gpu_devices(nullptr, 0, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_open(0, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_upload(nullptr, nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_draw(nullptr, nullptr, nullptr, nullptr, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_gpu_test(nullptr, 0, nullptr, nullptr, nullptr, 0) == GS_BAD_ARGUMENT);
    gs_gpu_close(nullptr);
    gs_gpu_release(nullptr);
}

} // namespace

int main() {
    nulls_are_refused();
    int32_t count = 0;
    const gs_status status = gs_gpu_devices(nullptr, 0, &count);
    CHECK(status == GS_OK || (status == GS_UNSUPPORTED && count == 0));
    if (count == 0) {
        const char *required = std::getenv("GSCORE_GPU_REQUIRED");
        std::printf("no device: %s\n", gs_gpu_last_error());
        CHECK(!required || !std::strcmp(required, "0") || !*required);
    }
    gs_gpu *gpu = nullptr;
    CHECK(gs_gpu_open(count, &gpu) != GS_OK);
    for (int32_t i = 0; i < count; ++i) {
        if (gs_gpu_open(i, &gpu) != GS_OK) {
            std::printf("device %d: %s\n", i, gs_gpu_last_error());
            continue;
        }
        pictures_are_those_of_the_cpu(gpu);
        lists_grow_with_the_pictures(gpu);
        what_cannot_be_drawn_is_refused(gpu);
        models_are_created(gpu);
        freed_buffers_are_not_read(gpu);
        too_many_entries_are_refused(gpu);
        photos_stay(gpu);
        gs_gpu_close(gpu);
    }
    return failures == 0 ? 0 : 1;
}
