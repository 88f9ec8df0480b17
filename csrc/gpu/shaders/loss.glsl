// Loss of a picture, shared part: image and photo as they enter it, windows, sums of a tile.
#extension GL_GOOGLE_include_directive : require
#define GS_PUSH gs_loss_push
#include "common.glsl"

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_loss_block {
    gs_loss_frame of;
};

#define loss push.block.of

const int kReach = GS_SSIM_WINDOW / 2;
// Side of a tile with the reach of its windows.
const int kSide = GS_TILE + 2 * kReach;
const float kTap[kReach + 1] = float[kReach + 1](GS_SSIM_TAPS);
// Values are shifted, which does not change variances, so that those of bright pictures keep their digits.
const float kShift = 0.5;
const float kWhite = 1.0 - kShift;

const uint kMaskComposite = 1, kMaskIgnore = 2;

ivec2 own_tile() { return ivec2(gl_WorkGroupID.x, gl_WorkGroupID.y + push.first_row); }
uint own_tile_number() { return (gl_WorkGroupID.y + push.first_row) * loss.tiles_x + gl_WorkGroupID.x; }
bool in_picture(ivec2 pixel) {
    return pixel.x >= 0 && pixel.y >= 0 && pixel.x < int(loss.width) && pixel.y < int(loss.height);
}
// Number of a pixel in the picture.
uint number_of(ivec2 pixel) { return uint(pixel.y) * loss.width + uint(pixel.x); }

float byte_of(uint word, uint at) { return float(word >> 8 * (at % 4) & 255u) * (1.0 / 255.0); }
float photo_at(uint at) { return byte_of(loss.photo.at[at / 4], at); }
// 1 without a mask.
float mask_at(uint pixel) { return loss.has_mask != 0 ? byte_of(loss.mask.at[pixel / 4], pixel) : 1.0; }

// A channel of image and photo at a pixel, shifted.
vec2 compared(uint pixel, int c) {
    float x = loss.rgb.at[3 * pixel + c], y = photo_at(3 * pixel + c);
    if (loss.has_gain != 0)
        x = x < loss.dark[c] ? x * loss.steep[c] : x * loss.gain[c] + GS_EXPOSURE_OFFSET * (loss.gain[c] - 1.0);
    if (loss.mask_mode == kMaskComposite) {
        float m = mask_at(pixel);
        y = y * m + loss.background[c] * (1.0 - m);
    } else if (loss.mask_mode == kMaskIgnore) {
        float m = mask_at(pixel);
        x *= m;
        y *= m;
    }
    x -= kShift;
    y -= kShift;
    if (loss.has_gain != 0 && y >= kWhite && x > kWhite)
        x = kWhite; // the photo is overexposed
    return vec2(x, y);
}

shared vec4 tree[GS_GROUP];

// Sum of the values of all invocations, in a fixed order; to be called by all.
vec4 sum_of_group(vec4 value) {
    uint id = lane();
    barrier(); // the array may be in use
    tree[id] = value;
    barrier();
    for (uint half_count = GS_GROUP / 2; half_count > 0; half_count /= 2) {
        if (id < half_count)
            tree[id] += tree[id + half_count];
        barrier();
    }
    return tree[0];
}
