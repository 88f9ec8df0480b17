// Writes the entries, one per invocation, so that a splat over thousands of tiles does not occupy one invocation alone.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "ellipse.glsl"

void main() {
    uint entry = group_number() * GS_GROUP + lane();
    if (entry >= frame.counters.at[GS_COUNT_ENTRIES])
        return;
    // The last splat whose first entry is at most this one. Splats without entries come before one with the same offset.
    uint low = 0, high = frame.counters.at[GS_COUNT_VISIBLE];
    while (high - low > 1) {
        uint middle = low + (high - low) / 2;
        if (frame.offsets.at[middle] <= entry)
            low = middle;
        else
            high = middle;
    }
    uint row = frame.visible_rows.at[low];
    int left = int(entry - frame.offsets.at[low]);
    Splat s = load_splat(row);
    ivec2 rows = tile_rows_of(s);
    uint tile = 0;
    for (int y = rows.x; y <= rows.y; ++y) {
        ivec2 tiles = tiles_in_row(s, y);
        int here = max(tiles.y - tiles.x + 1, 0);
        if (left < here) {
            tile = uint(y) * frame.tiles_x + uint(tiles.x + left);
            break;
        }
        left -= here;
    }
    frame.entry_rows.at[entry] = row;
    push.keys_out.at[entry] = tile;
    push.values_out.at[entry] = entry;
}
