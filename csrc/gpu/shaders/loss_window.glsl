// Windows of the loss over a tile: a value of each pixel, filtered down its column, then along its row.

shared vec4 down[GS_TILE * kSide]; // filtered down

// The value at a place of the tile with its margins.
vec4 value_at(uint i);

void filter_down() {
    for (uint i = lane(); i < GS_TILE * kSide; i += GS_GROUP) {
        uint centre = i + kReach * kSide;
        vec4 sum = kTap[0] * value_at(centre);
        for (uint k = 1; k <= kReach; ++k)
            sum = fma(vec4(kTap[k]), value_at(centre - k * kSide) + value_at(centre + k * kSide), sum);
        down[i] = sum;
    }
}

vec4 filtered_along(ivec2 local) {
    uint centre = local.y * kSide + local.x + kReach;
    vec4 sum = kTap[0] * down[centre];
    for (uint k = 1; k <= kReach; ++k)
        sum = fma(vec4(kTap[k]), down[centre - k] + down[centre + k], sum);
    return sum;
}
