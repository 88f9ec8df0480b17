// C API of feature matching: checks arguments and calls it.
#include "api.h"
#include "match.h"

#include <initializer_list>

using namespace gs;

namespace {

gs_status check_descriptors(const gs_descriptors &d) {
    if (d.count < 0 || d.count > GS_DESCRIPTORS_MAX || (d.count > 0 && !d.values))
        return fail(GS_BAD_ARGUMENT, "descriptors must be 0 to %d per photo and not null, got %d", GS_DESCRIPTORS_MAX,
                    d.count);
    return GS_OK;
}

} // namespace

gs_status gs_match_descriptors(const gs_descriptors *first, const gs_descriptors *second, double max_distance,
                               double max_ratio, int32_t *matches) {
    if (!first || !second || (first->count > 0 && !matches))
        return fail(GS_BAD_ARGUMENT, "gs_match_descriptors: an argument or an array is null");
    for (const gs_descriptors *d : {first, second})
        if (const gs_status s = check_descriptors(*d))
            return s;
    if (!(max_distance >= 0) || !(max_ratio >= 0 && max_ratio <= 1))
        return fail(GS_BAD_ARGUMENT, "max_distance must be 0 or more and max_ratio 0 to 1, got %g and %g", max_distance,
                    max_ratio);
    return guarded("gs_match_descriptors", [&] {
        match_descriptors(*first, *second, max_distance, max_ratio, matches);
        return GS_OK;
    });
}
