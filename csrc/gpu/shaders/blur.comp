// A pass of the blur of a picture, or of its adjoint: at each pixel of a tile, taps are added, and the sum divided by
// the weights of those that are in the picture. As csrc/src/blur.cpp, the adjoint divides by the weights of a pass first
// and then adds its taps. Its last pass also sums the gradient times the transmittance.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "loss.glsl"

// Where a tap of a pixel is.
ivec2 tapped(ivec2 pixel, uint tap) {
    int word = int(loss.taps.at[2 * tap]);
    return pixel + ivec2(word << 16 >> 16, word >> 16);
}

float weight_of(uint tap) { return uintBitsToFloat(loss.taps.at[2 * tap + 1]); }

vec3 colour_at(ivec2 pixel) {
    uint at = 3 * number_of(pixel);
    return vec3(push.from.at[at], push.from.at[at + 1], push.from.at[at + 2]);
}

// Sums of weighted colours, and of weights.
vec4 added(ivec2 pixel, uint pass_number) {
    vec4 sum = vec4(0.0);
    uint end = loss.tap_ends[pass_number + 1];
    for (uint tap = loss.tap_ends[pass_number]; tap < end; ++tap) {
        ivec2 at = tapped(pixel, tap);
        if (in_picture(at))
            sum += weight_of(tap) * vec4(colour_at(at), 1.0);
    }
    return sum;
}

float weights_of(ivec2 pixel, uint pass_number) {
    float sum = 0.0;
    uint end = loss.tap_ends[pass_number + 1];
    for (uint tap = loss.tap_ends[pass_number]; tap < end; ++tap)
        if (in_picture(tapped(pixel, tap)))
            sum += weight_of(tap);
    return sum;
}

void main() {
    uint id = lane();
    ivec2 pixel = GS_TILE * own_tile() + ivec2(id % GS_TILE, id / GS_TILE);
    vec4 value = vec4(0.0);
    if (in_picture(pixel)) {
        if (push.add == GS_BLUR_NONE)
            value.xyz = colour_at(pixel);
        else
            value = added(pixel, push.add);
        if (push.divide != GS_BLUR_NONE)
            value.xyz /= push.divide == push.add ? value.w : weights_of(pixel, push.divide);
        uint at = 3 * number_of(pixel);
        for (int c = 0; c < 3; ++c)
            push.to.at[at + c] = value[c];
    }
    if (push.divide != GS_BLUR_NONE || loss.fixed_background == 0)
        return;
    float transmittance = in_picture(pixel) ? 1.0 - loss.alpha.at[number_of(pixel)] : 0.0;
    vec4 through = sum_of_group(vec4(value.xyz * transmittance, 0.0));
    if (id < 3)
        loss.sums.at[(GS_LOSS_THROUGH + id) * loss.tiles + own_tile_number()] = through[id];
}
