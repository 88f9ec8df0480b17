// A pass of the stable radix sort by GS_DIGIT_BITS bits, from keys_in and values_in to keys_out and values_out, with counts
// in shared memory only: no subgroup operation and no order among workgroups is relied on. word0 is the counter with the
// number of keys, word1 the lowest bit.

uint sort_count() { return frame.counters.at[push.word0]; }

uint digit_of(uint key) { return key >> push.word1 & (GS_DIGITS - 1); }
