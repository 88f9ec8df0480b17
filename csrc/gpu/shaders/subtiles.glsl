// Subtiles of a tile, 32 pixels each: an invocation has a pixel, and splats that miss a subtile are skipped there.

const uint kLanesPerSubtile = GS_SUBTILE_WIDTH * GS_SUBTILE_HEIGHT;
const uint kWords = GS_GROUP / 32;
shared uint hits[GS_SUBTILES][kWords]; // splats of the batch that reach a subtile, a bit each

// Pixel of an invocation, in the tile.
ivec2 pixel_of(uint id) {
    uint subtile = id / kLanesPerSubtile, within = id % kLanesPerSubtile;
    return ivec2(subtile % 2 * GS_SUBTILE_WIDTH + within % GS_SUBTILE_WIDTH,
                 subtile / 2 * GS_SUBTILE_HEIGHT + within / GS_SUBTILE_WIDTH);
}

// Bits of the subtiles that a splat reaches.
uint subtiles_of(Splat s, ivec2 first) {
    uint found = 0;
    for (int r = 0; r < GS_TILE / GS_SUBTILE_HEIGHT; ++r) {
        int y = first.y + r * GS_SUBTILE_HEIGHT;
        ivec2 columns = columns_of(s, y, y + GS_SUBTILE_HEIGHT - 1) - first.x;
        if (columns.x <= columns.y) {
            found |= columns.x < GS_SUBTILE_WIDTH && columns.y >= 0 ? 1u << 2 * r : 0u;
            found |= columns.x < GS_TILE && columns.y >= GS_SUBTILE_WIDTH ? 2u << 2 * r : 0u;
        }
    }
    return found;
}

// To be called by all invocations, with a barrier before `add_hits`.
void clear_hits() {
    if (lane() < GS_SUBTILES * kWords)
        hits[lane() / kWords][lane() % kWords] = 0;
}

// Marks the splat of this invocation in the subtiles that it reaches.
void add_hits(uint reached) {
    for (uint k = 0; k < GS_SUBTILES; ++k)
        if ((reached >> k & 1u) != 0)
            atomicOr(hits[k][lane() / 32], 1u << lane() % 32);
}
