// Lists the splats in the picture, in the order of their rows.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "scan.glsl"

void main() {
    uint row = group_number() * GS_GROUP + lane();
    uint key = row < frame.count ? frame.keys.at[row] : GS_NO_KEY;
    uint total;
    uint before = scan_group(key != GS_NO_KEY ? 1u : 0u, total);
    if (key != GS_NO_KEY) {
        uint at = frame.sums.at[group_number()] + before;
        frame.visible_keys.at[at] = key;
        frame.visible_rows.at[at] = row;
    }
}
