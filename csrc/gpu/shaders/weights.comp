// Blending weights of the entries of a tile, summed over its pixels with three weights each. An invocation has a splat of
// the batch; pixels pass through the splats in their order, so each is at one of them at a time, and every sum has a fixed
// order.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"
#include "ellipse.glsl"
#include "blend.glsl"

shared float transmittances[GS_GROUP];

void main() {
    Tile tile = own_tile();
    uint id = lane();
    ivec2 own = tile.first + ivec2(id % GS_TILE, id / GS_TILE);
    transmittances[id] = own.x < frame.view.width && own.y < frame.view.height ? 1.0 : 0.0;
    for (uint begin = tile.begin; begin < tile.end; begin += GS_GROUP) {
        bool has_splat = begin + id < tile.end;
        uint slot = 0;
        if (has_splat) {
            slot = slot_of(begin + id);
            put_into_batch(id, load_splat(frame.entry_rows.at[slot]), tile.first);
        }
        uint splats = min(tile.end - begin, uint(GS_GROUP));
        vec3 sum = vec3(0.0);
        barrier();
        for (uint turn = 0; turn < GS_GROUP + splats; ++turn) {
            uint place = turn - id; // of a pixel in the tile
            if (has_splat && place < GS_GROUP) {
                float transmittance = transmittances[place];
                ivec2 local = ivec2(place % GS_TILE, place / GS_TILE);
                if (transmittance > 0.0) {
                    ivec2 pixel = tile.first + local;
                    float weight = alpha_at(id, vec2(local)) * transmittance, next = transmittance - weight, far;
                    if (next <= GS_TRANSMITTANCE_MIN || (far_depth(pixel, far) && batch_z[id] > far)) {
                        next = 0.0; // complete
                    } else {
                        int at = 3 * (pixel.y * frame.view.width + pixel.x);
                        for (int k = 0; k < 3; ++k)
                            sum[k] = fma(weight, frame.shares.at[at + k], sum[k]);
                    }
                    transmittances[place] = next;
                }
            }
            barrier();
        }
        if (has_splat)
            for (uint k = 0; k < 3; ++k)
                frame.entry_sums.at[k * frame.entry_capacity + slot] = sum[k];
        barrier();
    }
}
