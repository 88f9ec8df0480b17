// Mesh depth: inverse depth of a triangle mesh at pixel centres.
#pragma once

#include "gscore/mesh.h"

namespace gs {

// Maximum magnitude of a corner's numbers: products of three of them are far from overflow.
constexpr double kMeshLargest = 1e50;

// Expects a mesh with checked numbers and indices.
void mesh_depth(const gs_mesh &mesh, int32_t width, int32_t height, float *inverse_depth);

} // namespace gs
