// Depth of meshes of any corners and triangles: every pixel and nothing beyond is written, depths are within those of
// the corners, and invalid meshes are refused.
#include "scene.h"

#include <algorithm>

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Noise noise(in.word());
    const int32_t width = 1 + in.byte() % 90, height = 1 + in.byte() % 70;
    const size_t corners = 1 + in.byte() % 40, triangles = in.byte() % 40;
    const float depth = in.byte() % 2 ? 1.0f : 1e-6f;
    std::vector<double> places;
    for (size_t i = 0; i < corners; ++i) {
        const double z = noise(in.byte() % 2 ? -1.0f : 0.1f, 3) * depth;
        places.insert(places.end(), {noise(-20, 110) * z, noise(-20, 90) * z, z});
    }
    std::vector<int32_t> rows(3 * triangles);
    for (int32_t &row : rows)
        row = int32_t(noise(0, float(corners)));
    for (int k = in.byte() % 4; k > 0; --k)
        places[in.byte() % places.size()] = in.hostile();
    bool wrong = false;
    if (in.byte() % 8 == 0 && !rows.empty()) {
        rows[in.byte() % rows.size()] = int32_t(in.word());
        for (const int32_t row : rows)
            wrong = wrong || row < 0 || size_t(row) >= corners;
    }
    const double near = in.byte() % 2 ? double(noise(0, 4)) * depth : 0;
    const int32_t threads = 1 + in.byte() % 3;
    for (const double v : places)
        wrong = wrong || !std::isfinite(v);
    const gs_mesh mesh = {int64_t(corners), places.data(), int64_t(triangles), rows.data()};
    Output out(size_t(width) * size_t(height));
    const gs_status status = gs_mesh_depth(&mesh, near, width, height, threads, out.data());
    REQUIRE(out.guards_hold());
    REQUIRE(wrong ? status == GS_BAD_ARGUMENT && std::strlen(gs_last_error()) > 0 : status == GS_OK);
    double farthest = 0;
    for (size_t i = 2; i < places.size(); i += 3)
        farthest = std::max(farthest, places[i]);
    for (size_t i = 0; status == GS_OK && i < out.size(); ++i)
        REQUIRE(out.written(i) && std::isfinite(out[i]) && double(out[i]) * near <= 1.001 &&
                (out[i] == 0 || double(out[i]) * farthest >= 0.999));
    return 0;
}
