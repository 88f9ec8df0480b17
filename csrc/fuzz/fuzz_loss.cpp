// The fused loss on hostile pictures: no crash, and finite pictures give a finite loss and gradient.
#include "bytes.h"
#include "gscore.h"

#include <algorithm>
#include <cmath>

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Noise noise(in.word());
    const int width = 1 + in.byte() % 90, height = 1 + in.byte() % 90;
    const size_t pixels = size_t(width) * size_t(height);
    std::vector<float> image(3 * pixels);
    std::vector<uint8_t> target(3 * pixels), mask(pixels);
    const uint8_t flags = in.byte();
    const uint8_t exposure = in.byte(); // without or with a gain; photos that are white in places
    const bool flat = flags & 1, equal = flags & 2;
    for (size_t i = 0; i < image.size(); ++i) {
        target[i] = exposure & 2 && i % 7 < 3 ? 255 : flat ? 128 : uint8_t(noise(0, 256));
        image[i] = equal ? float(target[i]) / 255 : noise(-0.2f, 1.2f);
    }
    for (uint8_t &m : mask)
        m = flags & 4 ? uint8_t(noise(0, 256)) : flags & 8 ? 0 : 255;
    gs_loss_args args = {width,          height,      image.data(), target.data(),   mask.data(),
                         flags >> 4 & 3, {0, 0.5, 1}, 0.2f,         1 + (flags >> 6)};
    float gain[3] = {noise(0.05f, 2), 1, noise(0.5f, 4)};
    args.gain = exposure & 1 ? gain : nullptr;
    float largest = 1;
    while (!in.empty()) {
        const uint8_t what = in.byte();
        const uint32_t at = in.byte() | uint32_t(in.byte()) << 8;
        if (what < 220) {
            image[at % image.size()] = in.hostile();
        } else if (what < 235) {
            args.background[what % 3] = in.hostile();
        } else if (what < 245) {
            args.ssim_weight = in.hostile();
        } else if (what < 248) {
            args.mask_mode = int(at) - 2;
        } else if (what < 252) {
            gain[at % 3] = in.hostile();
        } else {
            args.mask = nullptr;
        }
    }
    for (const float x : image)
        largest = std::isfinite(x) ? std::max(largest, std::fabs(x)) : INFINITY;
    for (int c = 0; args.gain && c < 3; ++c)
        largest *= std::max(1.0f, std::pow(std::fabs(gain[c]), 2.4f)); // negative values are in the dark
    if (args.mask_mode == GS_MASK_COMPOSITE)
        for (const float b : args.background)
            largest = std::isfinite(b) ? std::max(largest, std::fabs(b)) : INFINITY;

    gs_raster *raster = nullptr;
    REQUIRE(gs_raster_create(&raster) == GS_OK);
    Output gradient(image.size()), again(image.size());
    gs_loss_result result = {}, second = {};
    const gs_status status = gs_image_loss(raster, &args, &result, gradient.data());
    REQUIRE(gradient.guards_hold());
    if (status != GS_OK) {
        REQUIRE(status == GS_BAD_ARGUMENT && std::strlen(gs_last_error()) > 0);
    } else {
        REQUIRE(gradient.all_written());
        if (largest <= 1e6f) { // far beyond what pictures hold; squares of squares stay in float32
            REQUIRE(std::isfinite(result.loss) && std::isfinite(result.mse) && result.loss > -1e-6);
            REQUIRE(result.ssim <= 1 + 1e-6 && result.l1 >= 0 && result.mse >= 0);
            for (size_t i = 0; i < gradient.size(); ++i)
                REQUIRE(std::isfinite(gradient[i]));
            for (const double v : result.v_log_gain)
                REQUIRE(std::isfinite(v) && (args.gain || v == 0));
            REQUIRE(gs_image_loss(raster, &args, &second, nullptr) == GS_OK);
            REQUIRE(second.loss == result.loss && second.v_log_gain[0] == 0 && second.v_log_gain[2] == 0);
        }
        args.threads = args.threads == 1 ? 4 : 1;
        REQUIRE(gs_image_loss(raster, &args, &second, again.data()) == GS_OK);
        REQUIRE(std::memcmp(&result, &second, sizeof result) == 0 && gradient.same_bits(again));
    }
    gs_raster_destroy(raster);
    return 0;
}
