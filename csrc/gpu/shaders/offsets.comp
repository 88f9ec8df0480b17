// Number of the first entry of each splat, in their order by depth and by row.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "scan.glsl"

void main() {
    uint count = frame.counters.at[GS_COUNT_VISIBLE], first = group_number() * GS_BLOCK + lane() * GS_PER_LANE;
    uint own[GS_PER_LANE];
    uint sum = 0, total;
    for (uint k = 0; k < GS_PER_LANE; ++k) {
        own[k] = first + k < count ? frame.tile_counts.at[frame.visible_rows.at[first + k]] : 0;
        sum = add_saturating(sum, own[k]);
    }
    uint running = scan_group(sum, total);
    if (first < count)
        running = add_saturating(running, frame.sums.at[group_number()]);
    for (uint k = 0; k < GS_PER_LANE; ++k) {
        if (first + k < count) {
            frame.offsets.at[first + k] = running;
            frame.row_entries.at[frame.visible_rows.at[first + k]] = running;
        }
        running = add_saturating(running, own[k]);
    }
}
