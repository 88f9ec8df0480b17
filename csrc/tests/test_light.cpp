// Tests of light in the C interface without Python, for sanitizers and other machines: closed forms, refusals.
#include "check.h"

#include <cmath>

namespace {

constexpr int kSide = 8;
constexpr size_t kCount = 37;

// Floors at x = 0.1 i, with normals up.
struct Floors {
    std::vector<float> places = std::vector<float>(3 * kCount), normals = places;
    gs_surfaces surfaces = {};

    Floors() {
        for (size_t i = 0; i < kCount; ++i)
            places[3 * i] = 0.1f * float(i), normals[3 * i + 2] = 1;
        surfaces.count = kCount, surfaces.places = places.data(), surfaces.normals = normals.data();
        for (int k = 0; k < 3; ++k)
            surfaces.matrix[5 * k] = surfaces.turn[4 * k] = 1;
        surfaces.most = 16;
    }
    std::vector<float> radiance(const gs_light &light, int threads = 2) const {
        std::vector<float> out(3 * kCount, -777.0f);
        CHECK(gs_surface_radiance(&light, &surfaces, threads, out.data()) == GS_OK);
        return out;
    }
};

// Oracle: cos / d^2 by hand.
void a_point_fades_with_distance_and_angle() {
    const gs_lamp lamp = {0, 0, {2, 1, 0.5f}, {0, 0, 3}, {0, 0, -1}, 0.1f, {-2, 0}, 0, {-1, -1}};
    const gs_light light = {{}, 1, &lamp, 0, nullptr, 0, nullptr};
    const std::vector<float> found = Floors().radiance(light);
    for (size_t i = 0; i < kCount; ++i) {
        const double x = 0.1 * double(i), squared = x * x + 9;
        CHECK(std::fabs(found[3 * i] - 2 * 3 / (squared * std::sqrt(squared))) < 1e-6);
    }
    CHECK(same_bits(found, Floors().radiance(light, 1)));
}

// A map from above with a mesh in front of half of its pixels.
struct HalfMap {
    std::vector<float> depths = std::vector<float>(kSide * kSide);
    const float down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1};
    const gs_shadow_map map = {kSide, 1, depths.data(), nullptr, down, {2, 0, 10}, 2, 1, 10, 5, 0.01f};

    HalfMap() {
        for (int i = 0; i < kSide * kSide; ++i)
            depths[size_t(i)] = i % kSide < kSide / 2 ? 5.0f : 0.0f;
    }
};

// Oracle: half of the map has a mesh in front.
void a_map_shadows_what_is_behind() {
    const HalfMap half;
    const gs_lamp lamp = {1, 0, {1, 1, 1}, {}, {0, 0, -1}, 0, {-2, 0}, 0, {0, -1}};
    const std::vector<float> found = Floors().radiance({{}, 1, &lamp, 1, &half.map, 0, nullptr});
    CHECK(found[3 * 5] == 0 && found[3 * 30] == 1);
}

// Oracle: half of the map has a mesh in front; a channel that the sky lacks stays.
void a_map_hides_the_world() {
    const HalfMap half;
    const gs_sky sky = {{1, 2, 0}, 0};
    gs_light light = {{}, 0, nullptr, 1, &half.map, 1, &sky};
    light.world[0] = light.world[1] = light.world[2] = 2;
    const std::vector<float> found = Floors().radiance(light);
    CHECK(found[3 * 5] == 0 && found[3 * 5 + 1] == 0 && found[3 * 5 + 2] == found[3 * 30]);
    CHECK(std::fabs(found[3 * 30] - 2 * 0.28209479f) < 1e-6f);
}

void what_is_invalid_is_refused() {
    const Floors floors;
    std::vector<float> out(3 * kCount);
    const gs_lamp lamp = {1, 0, {1, 1, 1}, {}, {0, 0, -1}, 0, {-2, 0}, 0, {0, -1}};
    gs_shadow_map map = {};
    CHECK(gs_surface_radiance(nullptr, &floors.surfaces, 1, out.data()) == GS_BAD_ARGUMENT);
    const gs_light missing = {{}, 1, &lamp, 0, nullptr}, broken = {{}, 1, &lamp, 1, &map, 0, nullptr}, none = {};
    const gs_sky beyond = {{1, 1, 1}, 0};
    const gs_light mapless = {{}, 0, nullptr, 0, nullptr, 1, &beyond},
                   absent = {{}, 0, nullptr, 0, nullptr, 1, nullptr};
    CHECK(gs_surface_radiance(&mapless, &floors.surfaces, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_surface_radiance(&absent, &floors.surfaces, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_surface_radiance(&missing, &floors.surfaces, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_surface_gains(&broken, &floors.surfaces, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_surface_gains(&none, &floors.surfaces, -1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_surface_gains(&none, &floors.surfaces, 1, nullptr) == GS_BAD_ARGUMENT);
    const gs_colors colors = {1, 25, out.data(), out.data(), out.data()};
    CHECK(gs_scale_colors(&colors, 1, out.data(), out.data()) == GS_BAD_ARGUMENT);
}

} // namespace

int main() {
    return on_every_isa([] {
        a_point_fades_with_distance_and_angle();
        a_map_shadows_what_is_behind();
        a_map_hides_the_world();
        what_is_invalid_is_refused();
    });
}
