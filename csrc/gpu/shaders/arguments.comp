// Writes a count and the arguments of the indirect dispatches over it: of the splats in the picture (word0 0), or of the
// entries (word0 1). The count is sums[word2], or where word1 is not 0 the total of the scan over blocks of GS_BLOCK splats.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"

void write_arguments(uint at, uint groups) {
    frame.counters.at[at] = min(groups, 65535u);
    frame.counters.at[at + 1] = (groups + 65534u) / 65535u;
    frame.counters.at[at + 2] = 1u;
}

void main() {
    if (lane() != 0)
        return;
    if (push.word0 == 0) {
        uint visible = frame.sums.at[push.word2];
        frame.counters.at[GS_COUNT_VISIBLE] = visible;
        write_arguments(GS_ARGS_VISIBLE_BLOCKS, (visible + GS_BLOCK - 1) / GS_BLOCK);
    } else {
        uint blocks = (frame.counters.at[GS_COUNT_VISIBLE] + GS_BLOCK - 1) / GS_BLOCK;
        uint entries = frame.sums.at[blocks];
        bool overflow = entries > frame.entry_capacity;
        frame.counters.at[GS_COUNT_ENTRIES] = overflow ? 0u : entries;
        frame.counters.at[GS_COUNT_OVERFLOW] = overflow ? entries : 0u;
        entries = overflow ? 0u : entries;
        write_arguments(GS_ARGS_ENTRIES, (entries + GS_GROUP - 1) / GS_GROUP);
        write_arguments(GS_ARGS_ENTRY_BLOCKS, (entries + GS_BLOCK - 1) / GS_BLOCK);
    }
}
