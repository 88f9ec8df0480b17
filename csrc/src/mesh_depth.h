// Mesh depth: interface shared by driver and kernels.
#pragma once

#include "gscore/mesh.h"

namespace gs {

// Maximum magnitude of a corner's numbers: products of three of them are far from overflow.
constexpr double kMeshLargest = 1e50;

// Expects a mesh with checked numbers and indices; arguments of gs_mesh_depth.
void mesh_depth(const gs_mesh &mesh, double near, int32_t width, int32_t height, int threads, float *inverse_depth);

struct MeshArgs {
    const gs_mesh *mesh;
    double near;
    int32_t width, height, bands; // bands of rows, drawn separately
    float *inverse_depth;
    uint8_t *sides; // [bands, V] scratch
};

} // namespace gs
