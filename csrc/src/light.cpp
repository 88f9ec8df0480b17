// Light driver: chunks of surfaces in parallel.
#include "light.h"

#include "cpu_dispatch.h"
#include "parallel.h"
#include "thread_count.h"

namespace gs {

void surface_light(const LightArgs &args, int threads) {
    const Kernels &k = kernels();
    parallel_for(size_t(chunks_of(args.surfaces->count)), threads_of(threads),
                 [&](size_t chunk, int) { k.surface_light(args, int64_t(chunk)); });
}

void scale_colors(const ColorArgs &args, int threads) {
    const Kernels &k = kernels();
    parallel_for(size_t(chunks_of(args.colors->count)), threads_of(threads),
                 [&](size_t chunk, int) { k.scale_colors(args, int64_t(chunk)); });
}

} // namespace gs
