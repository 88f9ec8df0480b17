// Stereo check of depth maps: counts the views that agree with each pixel, and those that contradict it.
#include "stereo.h"

#include "parallel.h"
#include "thread_count.h"

#include <cmath>

namespace gs {

namespace {

struct Projection {
    float x, y, inverse_depth;
    bool in_front;
};

// Projects pixel (x, y) with its inverse depth into another view.
Projection project_at(const gs_stereo_warp &warp, float x, float y, float inverse_depth) {
    float p[3];
    for (int i = 0; i < 3; ++i) {
        const float *const r = warp.rotation + 3 * i;
        p[i] = r[0] * x + r[1] * y + r[2] + inverse_depth * warp.translation[i];
    }
    const bool in_front = p[2] > 1e-12f;
    const float per = in_front ? 1.0f / p[2] : 0.0f;
    return {p[0] * per, p[1] * per, inverse_depth * per, in_front};
}

enum class Verdict { kNone, kAgrees, kContradicts };

struct Vote {
    Verdict verdict;
    float inverse_depth; // of the reference, according to the neighbour view if it agrees
};

Vote vote_of(const gs_stereo_check_args &a, const gs_stereo_neighbour &neighbour, float x, float y,
             float inverse_depth) {
    const Projection there = project_at(neighbour.warp, x, y, inverse_depth);
    // The comparisons treat NaN as outside.
    const bool inside = there.in_front && there.x >= 0 && there.y >= 0 && there.x < float(neighbour.width) &&
                        there.y < float(neighbour.height);
    if (!inside)
        return {Verdict::kNone, 0};
    const int column = int(there.x), line = int(there.y);
    const float known = neighbour.inverse_depth[int64_t(line) * neighbour.width + column];
    if (!(known > 0 && std::isfinite(known)))
        return {Verdict::kNone, 0};
    const Projection here = project_at(neighbour.back, float(column) + 0.5f, float(line) + 0.5f, known);
    const float dx = here.x - x, dy = here.y - y;
    if (here.in_front && dx * dx + dy * dy <= a.pixels * a.pixels &&
        std::fabs(here.inverse_depth - inverse_depth) <= a.relative * inverse_depth)
        return {Verdict::kAgrees, here.inverse_depth};
    const bool beyond = known * (1.0f + a.passed) < there.inverse_depth;
    return {beyond ? Verdict::kContradicts : Verdict::kNone, 0};
}

} // namespace

void stereo_check(const gs_stereo_check_args &a, uint8_t *agree, uint8_t *contradict, float *inverse_depth) {
    parallel_for(size_t(a.height), threads_of(a.threads), [&](size_t line, int) {
        for (int32_t column = 0; column < a.width; ++column) {
            const size_t at = line * size_t(a.width) + size_t(column);
            const float own = a.inverse_depth[at];
            agree[at] = contradict[at] = 0;
            inverse_depth[at] = 0;
            if (!(own > 0 && std::isfinite(own)))
                continue;
            float sum = own;
            for (int32_t i = 0; i < a.neighbour_count; ++i) {
                const Vote vote = vote_of(a, a.neighbours[i], float(column) + 0.5f, float(line) + 0.5f, own);
                agree[at] += vote.verdict == Verdict::kAgrees;
                contradict[at] += vote.verdict == Verdict::kContradicts;
                sum += vote.inverse_depth;
            }
            inverse_depth[at] = sum / float(agree[at] + 1);
        }
    });
}

} // namespace gs
