// Counts of what is looked at, which do not fit 32 bits.

fn count_samples(count: u32) {
    let old = atomicAdd(&stats[frame.view].samples_tested_lo, count);
    if old + count < old {
        atomicAdd(&stats[frame.view].samples_tested_hi, 1u);
    }
}

fn count_triangles(count: u32) {
    let old = atomicAdd(&stats[frame.view].triangles_tested_lo, count);
    if old + count < old {
        atomicAdd(&stats[frame.view].triangles_tested_hi, 1u);
    }
}

fn count_segments(count: u32) {
    let old = atomicAdd(&stats[frame.view].segments_tested_lo, count);
    if old + count < old {
        atomicAdd(&stats[frame.view].segments_tested_hi, 1u);
    }
}
