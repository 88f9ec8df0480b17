// Scans of a workgroup, without subgroup operations, so that results and order do not depend on their size.

shared uint scan_shared[GS_GROUP];

// Sum that stays at the largest word where it would overflow; associative, so scans may use it in any order.
uint add_saturating(uint a, uint b) {
    uint sum = a + b;
    return sum < a ? 0xFFFFFFFFu : sum;
}

// Sum of the values of all invocations before this one; `total` receives that of all. To be called by all.
uint scan_group(uint value, out uint total) {
    uint id = lane();
    scan_shared[id] = value;
    barrier();
    uint sum = value;
    for (uint reach = 1; reach < GS_GROUP; reach *= 2) {
        uint other = id >= reach ? scan_shared[id - reach] : 0;
        barrier();
        sum = add_saturating(sum, other);
        scan_shared[id] = sum;
        barrier();
    }
    total = scan_shared[GS_GROUP - 1];
    uint before = id > 0 ? scan_shared[id - 1] : 0;
    barrier(); // the array may be used again
    return before;
}
