// Stereo check of depth maps: views that agree with each pixel, and views that see through it.
#include "stereo.h"

#include "parallel.h"
#include "thread_count.h"

#include <cmath>

namespace gs {

namespace {

struct Seen {
    float x, y, inverse_depth;
    bool in_front;
};

// Where another camera sees what lies at (x, y), and at which inverse depth.
Seen seen_at(const gs_stereo_warp &warp, float x, float y, float inverse_depth) {
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

struct Answer {
    Verdict verdict;
    float inverse_depth; // of the reference, as the witness has it where it agrees
};

Answer ask(const gs_stereo_check_args &a, const gs_stereo_witness &witness, float x, float y, float inverse_depth) {
    const Seen there = seen_at(witness.warp, x, y, inverse_depth);
    // Written so that NaN is outside.
    const bool inside = there.in_front && there.x >= 0 && there.y >= 0 && there.x < float(witness.width) &&
                        there.y < float(witness.height);
    if (!inside)
        return {Verdict::kNone, 0};
    const int column = int(there.x), line = int(there.y);
    const float known = witness.inverse_depth[int64_t(line) * witness.width + column];
    if (!(known > 0 && std::isfinite(known)))
        return {Verdict::kNone, 0};
    const Seen here = seen_at(witness.back, float(column) + 0.5f, float(line) + 0.5f, known);
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
            for (int32_t i = 0; i < a.witness_count; ++i) {
                const Answer answer = ask(a, a.witnesses[i], float(column) + 0.5f, float(line) + 0.5f, own);
                agree[at] += answer.verdict == Verdict::kAgrees;
                contradict[at] += answer.verdict == Verdict::kContradicts;
                sum += answer.inverse_depth;
            }
            inverse_depth[at] = sum / float(agree[at] + 1);
        }
    });
}

} // namespace gs
