// CPU dispatch: the available instruction sets, and the kernels in use.
#pragma once

#include "types.h"

namespace gs {

const Kernels &kernels();
// Selects an instruction set; false if it is not available.
bool use_kernels(const char *name);
const char *available_kernels();

} // namespace gs
