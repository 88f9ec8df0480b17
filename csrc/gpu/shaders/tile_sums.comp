// Sums the numbers of tiles of blocks of splats, in their order by depth.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "scan.glsl"

void main() {
    uint count = frame.counters.at[GS_COUNT_VISIBLE], first = group_number() * GS_BLOCK + lane() * GS_PER_LANE;
    uint sum = 0, total;
    for (uint k = 0; k < GS_PER_LANE; ++k)
        if (first + k < count)
            sum = add_saturating(sum, frame.tile_counts.at[frame.visible_rows.at[first + k]]);
    scan_group(sum, total);
    if (lane() == 0 && group_number() * GS_BLOCK < count) // a folded dispatch has more groups
        frame.sums.at[group_number()] = total;
}
