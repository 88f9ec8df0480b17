// Exclusive scan of `sums` by one workgroup, in place; the total is written after the last number. The numbers are
// word1 words for each word2 of counter word0, or word2 words if word1 is 0.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "scan.glsl"

void main() {
    uint count = push.word2;
    if (push.word1 != 0)
        count = push.word1 * ((frame.counters.at[push.word0] + push.word2 - 1) / push.word2);
    uint before = 0;
    for (uint begin = 0; begin < count; begin += GS_BLOCK) {
        uint first = begin + lane() * GS_PER_LANE;
        uint own[GS_PER_LANE];
        uint sum = 0;
        for (uint k = 0; k < GS_PER_LANE; ++k) {
            own[k] = first + k < count ? frame.sums.at[first + k] : 0;
            sum = add_saturating(sum, own[k]);
        }
        uint total;
        uint running = add_saturating(before, scan_group(sum, total));
        for (uint k = 0; k < GS_PER_LANE; ++k) {
            if (first + k < count)
                frame.sums.at[first + k] = running;
            running = add_saturating(running, own[k]);
        }
        before = add_saturating(before, total);
    }
    if (lane() == 0)
        frame.sums.at[count] = before;
}
