// Dispatch of instruction sets: those compiled in and supported here, and the one in use.
#pragma once

#include "types.h"

namespace gs {

const Kernels &kernels();
// False if it is not available.
bool use_kernels(const char *name);
const char *available_kernels();

} // namespace gs
