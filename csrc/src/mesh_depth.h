// Mesh depth: inverse depth of a triangle mesh at pixel centres.
#pragma once

#include "gscore.h"

namespace gs {

// Largest magnitude of a corner's numbers: products of three of them stay far from overflow.
constexpr double kMeshLargest = 1e50;

// Expects a mesh whose numbers and indices are checked.
void mesh_depth(const gs_mesh &mesh, int32_t width, int32_t height, float *inverse_depth);

} // namespace gs
