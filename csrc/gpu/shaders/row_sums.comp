// Adds the sums of the entries of each splat in the picture, in the order of its tiles; other rows stay zero.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"

void main() {
    uint visible = frame.counters.at[GS_COUNT_VISIBLE];
    for (uint k = 0; k < GS_PER_LANE; ++k) {
        uint rank = group_number() * GS_BLOCK + k * GS_GROUP + lane();
        if (rank < visible) {
            uint begin = frame.offsets.at[rank];
            uint end = rank + 1 < visible ? frame.offsets.at[rank + 1] : frame.counters.at[GS_COUNT_ENTRIES];
            uint row = frame.visible_rows.at[rank];
            for (uint c = 0; c < 3; ++c) {
                float sum = 0.0;
                for (uint e = begin; e < end; ++e)
                    sum += frame.entry_sums.at[c * frame.entry_capacity + e];
                frame.row_sums.at[3 * row + c] = sum;
            }
        }
    }
}
