// Rows and components of a table of splats in training, see model.h.
#define GS_PUSH gs_rows_push
#include "common.glsl"

// Number of the row of entry k of the array, with its mark.
uint row_of(uint k) { return (push.flags & GS_ROWS_LISTED) != 0u ? push.list.at[k] : k; }

uint word_of(uint row, uint component) {
    return (component / push.unit * push.rows + push.begin + (row & ~GS_FRESH)) * push.unit + component % push.unit;
}
