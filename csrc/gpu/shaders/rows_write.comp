// Writes components of rows from an array, or zeros.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "rows.glsl"

void main() {
    uint i = group_number() * GS_GROUP + lane();
    if (i >= push.count)
        return;
    uint word = 0u;
    if ((push.flags & GS_ROWS_CLEAR) == 0u)
        word = push.array.at[i];
    push.table.at[word_of(row_of(i / push.width), push.first + i % push.width)] = word;
}
