// First entry and end of each tile, in the sorted order of keys_in; tiles without entries keep zeros.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"

void main() {
    uint entry = group_number() * GS_GROUP + lane(), count = frame.counters.at[GS_COUNT_ENTRIES];
    if (entry >= count)
        return;
    uint tile = push.keys_in.at[entry];
    if (entry == 0 || push.keys_in.at[entry - 1] != tile)
        frame.tile_ranges.at[2 * tile] = entry;
    if (entry == count - 1 || push.keys_in.at[entry + 1] != tile)
        frame.tile_ranges.at[2 * tile + 1] = entry + 1;
}
