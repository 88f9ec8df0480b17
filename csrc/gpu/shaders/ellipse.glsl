// Projected splats, and the tiles and pixels that they reach. The region alpha >= 1/255 is an ellipse; its intersection
// with a band of pixel rows is convex, so the columns in it form one interval with closed-form ends.

// As `Projected` of csrc/src/raster_types.h: with d = pixel - mean, alpha = exp2(log2_opacity - u^2 - v^2),
// u = ua dx + ub dy, v = vc dy. The ellipse: half-sides of its box, and the middle and half-length of the horizontal chord
// at distance y, slope y and half_chord sqrt(extent.y^2 - y^2).
struct Splat {
    vec2 mean;
    float ua, ub, vc;
    float log2_opacity;
    vec3 color;
    float inverse_z, z;
    vec2 extent;
    float slope, half_chord;
};

void store_splat(uint row, Splat s) {
    frame.records.at[4 * row] = floatBitsToUint(vec4(s.mean, s.ua, s.ub));
    frame.records.at[4 * row + 1] = floatBitsToUint(vec4(s.vc, s.log2_opacity, s.color.rg));
    frame.records.at[4 * row + 2] = floatBitsToUint(vec4(s.color.b, s.inverse_z, s.z, s.extent.x));
    frame.records.at[4 * row + 3] = uvec4(floatBitsToUint(vec3(s.extent.y, s.slope, s.half_chord)), 0u);
}

Splat load_splat(uint row) {
    vec4 a = uintBitsToFloat(frame.records.at[4 * row]), b = uintBitsToFloat(frame.records.at[4 * row + 1]);
    vec4 c = uintBitsToFloat(frame.records.at[4 * row + 2]);
    vec3 d = uintBitsToFloat(frame.records.at[4 * row + 3].xyz);
    Splat s;
    s.mean = a.xy;
    s.ua = a.z;
    s.ub = a.w;
    s.vc = b.x;
    s.log2_opacity = b.y;
    s.color = vec3(b.zw, c.x);
    s.inverse_z = c.y;
    s.z = c.z;
    s.extent = vec2(c.w, d.x);
    s.slope = d.y;
    s.half_chord = d.z;
    return s;
}

// Slack for rounding of the ends, px: a column too many costs time, a missing one would change the picture.
float slack_px(float extent) { return 0.01 + 1e-4 * extent; }

// First and last column of the splat in the pixel rows from `first` to `last`; empty if the first is greater.
ivec2 columns_of(Splat s, int first, int last) {
    float slack_x = slack_px(s.extent.x), slack_y = slack_px(s.extent.y);
    float ex = s.extent.x, ey = s.extent.y;
    float low = max(float(first) + 0.5 - s.mean.y, -ey), high = min(float(last) + 0.5 - s.mean.y, ey);
    if (!(high + slack_y >= low - slack_y))
        return ivec2(1, 0);
    // The rightmost point of the ellipse is at this row, the leftmost at its negative.
    float row = s.slope * ey * (ey / ex);
    float right_row = min(max(row, low), high), left_row = min(max(-row, low), high);
    float right = s.slope * right_row + s.half_chord * sqrt(max(ey * ey - right_row * right_row, 0.0));
    float left = s.slope * left_row - s.half_chord * sqrt(max(ey * ey - left_row * left_row, 0.0));
    right = min(right, ex);
    left = max(left, -ex);
    float width = float(frame.view.width);
    float from = min(max(floor(s.mean.x + left + (0.5 - slack_x)), 0.0), width);
    float to = min(max(floor(s.mean.x + right + (slack_x - 0.5)), -1.0), width - 1.0);
    return ivec2(int(from), int(to));
}

// First and last row of tiles of the splat, within the frame's box; empty if the first is greater.
ivec2 tile_rows_of(Splat s) {
    float slack = slack_px(s.extent.y), height = float(frame.view.height);
    float from = min(max(floor(s.mean.y - s.extent.y - slack + 0.5), 0.0), height);
    float to = min(max(floor(s.mean.y + s.extent.y + slack - 0.5), -1.0), height - 1.0);
    if (from > to)
        return ivec2(1, 0);
    return ivec2(max(int(from) / GS_TILE, int(frame.tile_y0)), min(int(to) / GS_TILE, int(frame.tile_y1) - 1));
}

// First and last tile of the splat in a row of tiles, within the frame's box; empty if the first is greater. The only
// place that decides which tiles a splat has.
ivec2 tiles_in_row(Splat s, int tile_y) {
    ivec2 columns = columns_of(s, tile_y * GS_TILE, tile_y * GS_TILE + (GS_TILE - 1));
    if (columns.x > columns.y)
        return ivec2(1, 0);
    return ivec2(max(columns.x / GS_TILE, int(frame.tile_x0)), min(columns.y / GS_TILE, int(frame.tile_x1) - 1));
}

uint tiles_of(Splat s) {
    ivec2 rows = tile_rows_of(s);
    uint count = 0;
    for (int y = rows.x; y <= rows.y; ++y) {
        ivec2 tiles = tiles_in_row(s, y);
        count += uint(max(tiles.y - tiles.x + 1, 0));
    }
    return count;
}
