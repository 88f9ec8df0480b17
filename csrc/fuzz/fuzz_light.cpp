// Light on any surfaces by any lamps and maps: everything and nothing beyond is written, threads change no bit, tame
// light is finite, and invalid arguments are refused.
#include "scene.h"

#include <algorithm>

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

namespace {

std::vector<float> some(Bytes &in, Noise &noise, size_t count, bool hostile) {
    std::vector<float> values(count);
    for (float &value : values)
        value = noise(-2, 2);
    for (int k = hostile && count ? in.byte() % 4 : 0; k > 0; --k)
        values[in.byte() % count] = in.hostile();
    return values;
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Noise noise(in.word());
    fuzz::use_isa(in.byte());
    const bool hostile = in.byte() % 2;
    const size_t count = in.byte() % 70;
    const int side = 2 + in.byte() % 30, views = in.byte() % 2 ? 6 : 1, rest = in.byte() % 25;
    std::vector<float> depths = some(in, noise, size_t(views * side * side), hostile);
    const std::vector<float> rotations = some(in, noise, size_t(9 * views), hostile);
    const std::vector<float> backs = some(in, noise, depths.size(), hostile);
    gs_shadow_map map = {side,
                         views,
                         depths.data(),
                         in.byte() % 2 ? backs.data() : nullptr,
                         rotations.data(),
                         {0, 0, 1},
                         noise(0, 20),
                         in.byte() % 2,
                         5,
                         9,
                         0.01f};
    std::vector<gs_lamp> lamps(in.byte() % 4);
    for (gs_lamp &lamp : lamps) {
        lamp = {in.byte() % 2,
                in.byte() % 2,
                {1, 2, 3},
                {0, 1, 2},
                {0, 0, -1},
                noise(0, 1),
                {noise(-2, 1), 0.1f},
                0.3f * float(in.byte() % 2),
                {0, -1}};
        lamp.place[in.byte() % 3] = hostile ? in.hostile() : noise(-3, 3);
        lamp.maps[1] = in.byte() % 3 - 1;
    }
    bool wrong = std::any_of(lamps.begin(), lamps.end(), [](const gs_lamp &lamp) { return lamp.maps[1] > 0; });
    std::vector<gs_sky> sky(in.byte() % 3);
    for (gs_sky &one : sky) {
        one = {{noise(0, 2), noise(0, 2), noise(0, 2)}, in.byte() % 8 == 0 ? 1 : 0};
        wrong = wrong || one.map > 0 || views != 1 || !map.parallel;
    }
    gs_light light = {{}, int32_t(lamps.size()), lamps.data(), 1, &map, int32_t(sky.size()), sky.data()};
    for (float &value : light.world)
        value = noise(-1, 1);
    const std::vector<float> places = some(in, noise, 3 * count, hostile),
                             normals = some(in, noise, 3 * count, hostile);
    const std::vector<float> captured = some(in, noise, 3 * count, hostile);
    gs_surfaces surfaces = {};
    surfaces.count = int64_t(count), surfaces.places = places.data(), surfaces.normals = normals.data();
    surfaces.captured = in.byte() % 2 ? captured.data() : nullptr;
    for (int k = 0; k < 3; ++k)
        surfaces.matrix[5 * k] = surfaces.turn[4 * k] = 1;
    surfaces.share = noise(0, 1), surfaces.catches = in.byte() % 2, surfaces.most = 16;
    if (hostile) {
        float *const numbers[] = {&map.scale,      &map.farthest,  &map.nearest,        &map.place[2],    &map.slack,
                                  &light.world[9], &surfaces.most, &surfaces.matrix[3], &surfaces.turn[0]};
        *numbers[in.byte() % std::size(numbers)] = in.hostile();
        for (gs_lamp &lamp : lamps)
            (in.byte() % 2 ? lamp.size : lamp.radius) = in.hostile();
    }
    Output radiance(3 * count), gains(3 * count), again(3 * count);
    const gs_status wanted = wrong ? GS_BAD_ARGUMENT : GS_OK;
    REQUIRE(gs_surface_radiance(&light, &surfaces, 1, radiance.data()) == wanted);
    REQUIRE(gs_surface_gains(&light, &surfaces, 1, gains.data()) == wanted);
    REQUIRE(gs_surface_gains(&light, &surfaces, 3, again.data()) == wanted);
    REQUIRE(radiance.guards_hold() && gains.guards_hold() && again.same_bits(gains));
    if (wrong)
        return 0;
    REQUIRE(radiance.all_written() && gains.all_written());
    for (size_t i = 0; !hostile && i < 3 * count; ++i)
        REQUIRE(std::isfinite(radiance[i]) && std::isfinite(gains[i]) && radiance[i] >= 0);
    const std::vector<float> sh0 = some(in, noise, 3 * count, hostile);
    const std::vector<float> shN = some(in, noise, 3 * count * size_t(rest), hostile);
    const gs_colors colors = {int64_t(count), rest, sh0.data(), shN.data(), gains.data()};
    Output out0(3 * count), outN(shN.size());
    REQUIRE(gs_scale_colors(&colors, 2, out0.data(), outN.data()) == GS_OK);
    REQUIRE(out0.guards_hold() && outN.guards_hold() && out0.all_written() && outN.all_written());
    return 0;
}
