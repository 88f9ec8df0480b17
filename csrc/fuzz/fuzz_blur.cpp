// The blur of a picture, and its adjoint, with hostile pictures and covariances: no crash, bounded results.
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
    std::vector<float> image(3 * size_t(width) * size_t(height));
    for (float &x : image)
        x = noise(-0.2f, 1.2f);
    const uint8_t flags = in.byte();
    const float xx = noise(0, 30), yy = noise(0, 30), xy = noise(-1, 1) * std::sqrt(xx * yy);
    gs_blur_args args = {width, height, image.data(), {xx, xy, yy}, flags & 1, 1 + (flags >> 6)};
    while (!in.empty()) {
        const uint8_t what = in.byte();
        const uint32_t at = in.byte() | uint32_t(in.byte()) << 8;
        if (what < 230)
            image[at % image.size()] = in.hostile();
        else
            args.covariance[at % 3] = in.hostile();
    }
    float largest = 0;
    for (const float x : image)
        largest = std::isfinite(x) ? std::max(largest, std::fabs(x)) : INFINITY;

    Output blurred(image.size()), again(image.size());
    const gs_status status = gs_blur_image(&args, blurred.data());
    REQUIRE(blurred.guards_hold());
    if (status != GS_OK) {
        REQUIRE(status == GS_BAD_ARGUMENT && std::strlen(gs_last_error()) > 0);
        return 0;
    }
    REQUIRE(blurred.all_written());
    // A mean is no brighter than its picture; the adjoint adds the shares of several pixels.
    const float limit = (args.adjoint ? 8.0f : 1.0f) * largest * 1.001f;
    for (size_t i = 0; i < blurred.size() && largest <= 1e30f; ++i)
        REQUIRE(std::fabs(blurred[i]) <= limit);
    args.threads = args.threads == 1 ? 4 : 1;
    REQUIRE(gs_blur_image(&args, again.data()) == GS_OK && blurred.same_bits(again));
    return 0;
}
