// Kernels compiled for AVX2.
#define GS_NAMESPACE avx2
#define GS_ISA_AVX2
#include "kernels.inl.h"

namespace gs {
extern const Kernels kernels_avx2;
const Kernels kernels_avx2 = avx2::make_kernels("avx2");
} // namespace gs
