// Reads components of rows into an array.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "rows.glsl"

void main() {
    uint i = group_number() * GS_GROUP + lane();
    if (i >= push.count)
        return;
    uint row = row_of(i / push.width);
    uint word = push.table.at[word_of(row, push.first + i % push.width)];
    bool zero = (push.flags & GS_ROWS_FRESH) != 0u && (row & GS_FRESH) != 0u;
    push.array.at[i] = zero ? 0u : word;
}
