// Splats are sorted by their keys, digit by digit from the lowest on (a radix sort: Satish, Harris & Garland 2009), and then by the tiles
// that they reach into. Each of WORKERS threads takes a share of the list, in order, so that splats of equal keys keep their order and the
// result is always the same.
//
// `paint_counts` has a row for each value of the digit, of a number for each worker, and behind all rows their sums.
//!include shared/frame
//!include shared/painted
//!include shared/lanes

@group(0) @binding(5) var<storage, read_write> paint_list: PaintList;
@group(0) @binding(7) var<storage, read_write> paint_counts: array<u32>;

override WORKERS: u32 = 256u;
const VALUES: u32 = 256u;

// The share of a worker.
struct Share {
    first: u32,
    end: u32,
}

fn share_of(worker: u32, count: u32) -> Share {
    let each = (count + WORKERS - 1u) / WORKERS;
    let first = min(worker * each, count);
    return Share(first, min(first + each, count));
}

fn begin_counts(worker: u32) {
    for (var value = 0u; value < VALUES; value++) {
        paint_counts[value * WORKERS + worker] = 0u;
    }
}

// Where the entries of each value begin.
var<workgroup> begins: array<u32, 257>;

fn add_up_values(lane: u32) {
    for (var value = lane; value < VALUES; value += LANES) {
        begins[value + 1u] = paint_counts[VALUES * WORKERS + value];
    }
    workgroupBarrier();
    if lane == 0u {
        begins[0] = 0u;
        for (var value = 0u; value < VALUES; value++) {
            begins[value + 1u] += begins[value];
        }
    }
    workgroupBarrier();
}
