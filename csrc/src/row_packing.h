// Row packing: rows of several tables in one buffer, and back.
#pragma once

#include "gscore/optimizer.h"

namespace gs {

// Both skip entries out of the range of `rows`, and return the index of the first of these, or -1.

int64_t pack_rows(const gs_row_table *tables, int table_count, int64_t rows, const int64_t *places, float *packed,
                  int64_t count, int threads);

int64_t unpack_rows(const gs_row_table *tables, int table_count, int64_t rows, const float *packed, int32_t *marks,
                    int64_t count, int threads);

} // namespace gs
