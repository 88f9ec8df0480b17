// Mesh depth driver: draws bands of rows in parallel.
#include "mesh_depth.h"

#include "cpu_dispatch.h"
#include "parallel.h"
#include "thread_count.h"

#include <algorithm>
#include <vector>

namespace gs {

namespace {

// Bands per thread, because triangles are not spread evenly.
constexpr int kBands = 2;

} // namespace

void mesh_depth(const gs_mesh &mesh, double near, int32_t width, int32_t height, int threads, float *inverse_depth) {
    const int count = threads_of(threads), bands = count == 1 ? 1 : std::min(kBands * count, int(height));
    std::vector<uint8_t> sides(size_t(bands) * size_t(mesh.corner_count));
    const MeshArgs args = {&mesh, near, width, height, bands, inverse_depth, sides.data()};
    const Kernels &k = kernels();
    parallel_for(size_t(bands), std::min(count, bands), [&](size_t band, int) { k.mesh_depth(args, int(band)); });
}

} // namespace gs
