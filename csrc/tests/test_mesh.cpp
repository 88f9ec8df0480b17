// Tests of mesh depth in the C interface without Python, for sanitizers and other machines: closed forms, refusals.
#include "check.h"

#include <cmath>
#include <limits>

namespace {

constexpr int kWidth = 31, kHeight = 23;
constexpr size_t kPixels = size_t(kWidth) * size_t(kHeight);

std::vector<float> drawn(const std::vector<double> &corners, const std::vector<int32_t> &triangles,
                         gs_status wanted = GS_OK, double near = 0) {
    const gs_mesh mesh = {int64_t(corners.size() / 3), corners.data(), int64_t(triangles.size() / 3), triangles.data()};
    std::vector<float> out(kPixels, -777.0f);
    CHECK(gs_mesh_depth(&mesh, near, kWidth, kHeight, 2, out.data()) == wanted);
    return out;
}

// Corners (u z, v z, z) of places (u, v, z) in the picture.
std::vector<double> seen(std::vector<double> places) {
    for (size_t i = 0; i < places.size(); i += 3)
        places[i] *= places[i + 2], places[i + 1] *= places[i + 2];
    return places;
}

// Oracle: inverse depth is linear across a plane.
void a_slanted_square_has_its_depth_at_every_centre() {
    const auto inverse = [](double x) { return 0.2 + 0.01 * x; };
    std::vector<double> places;
    for (const double y : {-5.0, 40.0})
        for (const double x : {-8.0, 50.0})
            places.insert(places.end(), {x, y, 1 / inverse(x)});
    const std::vector<float> found = drawn(seen(places), {0, 1, 2, 2, 1, 3});
    for (size_t i = 0; i < kPixels; ++i)
        CHECK(std::fabs(found[i] - inverse(double(i % kWidth) + 0.5)) < 1e-6);
    CHECK(same_bits(found, drawn(seen(places), {2, 3, 1, 0, 2, 1}))); // the other side, in another order
}

// Oracle: the floor y = 1 below a horizontal camera of focal length 1 px: 1 / z = v.
void a_floor_from_behind_the_camera_to_the_horizon() {
    std::vector<double> corners;
    for (const double z : {-50.0, 1e6})
        for (const double x : {-1e7, 1e7})
            corners.insert(corners.end(), {x + 15 * z, 1.0 + 11.5 * z, z});
    const std::vector<float> found = drawn(corners, {0, 1, 2, 2, 1, 3});
    for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x)
            CHECK(std::fabs(found[size_t(y * kWidth + x)] - std::max(0.0, y + 0.5 - 11.5)) < 1e-4);
}

// Oracle: the same floor, without what is nearer than z = 1 / 4.3.
void a_floor_ends_at_the_near_plane() {
    std::vector<double> corners;
    for (const double z : {-50.0, 1e6})
        for (const double x : {-1e7, 1e7})
            corners.insert(corners.end(), {x + 15 * z, 1.0 + 11.5 * z, z});
    const std::vector<float> found = drawn(corners, {0, 1, 2, 2, 1, 3}, GS_OK, 1 / 4.3);
    for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x) {
            const double wanted = y + 0.5 - 11.5 <= 4.3 ? std::max(0.0, y + 0.5 - 11.5) : 0;
            CHECK(std::fabs(found[size_t(y * kWidth + x)] - wanted) < 1e-4);
        }
}

void what_is_no_mesh_is_refused() {
    const std::vector<double> corners = seen({0, 0, 1, 9, 0, 1, 0, 9, 1});
    for (const int32_t bad : {-1, 3, INT32_MAX}) {
        (void)drawn(corners, {0, 1, bad}, GS_BAD_ARGUMENT);
        CHECK(std::strlen(gs_last_error()) > 0);
    }
    for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity(), -1e60}) {
        std::vector<double> other = corners;
        other[4] = bad;
        (void)drawn(other, {0, 1, 2}, GS_BAD_ARGUMENT);
    }
    const gs_mesh none = {};
    std::vector<float> out(kPixels);
    CHECK(gs_mesh_depth(nullptr, 0, kWidth, kHeight, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_mesh_depth(&none, 0, kWidth, kHeight, 1, nullptr) == GS_BAD_ARGUMENT);
    CHECK(gs_mesh_depth(&none, 0, 0, kHeight, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_mesh_depth(&none, 0, kWidth, 65537, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_mesh_depth(&none, -1, kWidth, kHeight, 1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_mesh_depth(&none, 0, kWidth, kHeight, -1, out.data()) == GS_BAD_ARGUMENT);
    CHECK(gs_mesh_depth(&none, 0, kWidth, kHeight, 1, out.data()) == GS_OK);
}

} // namespace

int main() {
    a_slanted_square_has_its_depth_at_every_centre();
    a_floor_from_behind_the_camera_to_the_horizon();
    a_floor_ends_at_the_near_plane();
    what_is_no_mesh_is_refused();
    std::printf("mesh: %s\n", failures == 0 ? "passed" : "FAILED");
    return failures == 0 ? 0 : 1;
}
