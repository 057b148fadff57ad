// As sums_64, where 64-bit atomics are absent: the same words in halves.
@group(0) @binding(5) var<storage, read_write> sums_0: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> sums_1: array<atomic<u32>>;

fn add_0(pixel: u32, low: u32, high: u32) -> bool {
    atomicAdd(&sums_0[2u * pixel], low);
    let old = atomicAdd(&sums_0[2u * pixel + 1u], high);
    return old + high < high;
}

fn add_1(pixel: u32, low: u32, high: u32) {
    atomicAdd(&sums_1[2u * pixel], low);
    atomicAdd(&sums_1[2u * pixel + 1u], high);
}

// A product as one sum of 64 bits: `a` up to 2^15, `b` up to 2^30. Whoever makes the lower half wrap carries.
fn add_wide(pixel: u32, a: u32, b: u32) {
    let near = a * (b & 0x7fffu);
    let far = a * (b >> 15u);
    let low = near + (far << 15u);
    let high = (far >> 17u) + select(0u, 1u, low < near);
    let old = atomicAdd(&sums_1[2u * pixel], low);
    let carried = high + select(0u, 1u, old + low < old);
    if carried != 0u {
        atomicAdd(&sums_1[2u * pixel + 1u], carried);
    }
}
