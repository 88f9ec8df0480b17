// Kernels compiled for the baseline instruction set.
#define GS_NAMESPACE scalar
#define GS_ISA_SCALAR
#include "kernels.inl.h"

namespace gs {
extern const Kernels kernels_scalar;
const Kernels kernels_scalar = scalar::make_kernels("scalar");
} // namespace gs
