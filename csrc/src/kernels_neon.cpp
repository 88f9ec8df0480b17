// Kernels compiled for NEON.
#define GS_NAMESPACE neon
#define GS_ISA_NEON
#include "kernels.inl.h"

namespace gs {
extern const Kernels kernels_neon;
const Kernels kernels_neon = neon::make_kernels("neon");
} // namespace gs
