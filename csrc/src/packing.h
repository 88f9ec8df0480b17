// Rows of several tables side by side in one, and back.
#pragma once

#include "gscore.h"

namespace gs {

// The first of `count` packed rows of `width` numbers that is for no row of tables of `rows`; -1: there is none.
int64_t row_out_of_range(int64_t rows, const float *packed, int64_t count, int64_t width, int threads);

void pack_rows(const gs_row_table *tables, int table_count, float *packed, int64_t count, int threads);

void unpack_rows(const gs_row_table *tables, int table_count, const float *packed, int64_t count, int threads);

} // namespace gs
