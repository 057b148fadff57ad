// Sums of a pixel in integers, whose order does not matter. Each 64-bit word holds two sums of 32 bits; contributions have a
// weight of 15 bits at most, so that 2^17 of them fit; where more overlap, the frame is drawn again with smaller weights.
@group(0) @binding(5) var<storage, read_write> sums_0: array<atomic<u64>>;
@group(0) @binding(6) var<storage, read_write> sums_1: array<atomic<u64>>;

fn two_words(low: u32, high: u32) -> u64 {
    return (u64(high) << 32u) | u64(low);
}

// Whether the upper sum has wrapped. It is the weight, which no other sum exceeds.
fn add_0(pixel: u32, low: u32, high: u32) -> bool {
    let old = atomicAdd(&sums_0[pixel], two_words(low, high));
    return u32(old >> 32u) + high < high;
}

fn add_1(pixel: u32, low: u32, high: u32) {
    atomicAdd(&sums_1[pixel], two_words(low, high));
}

// A product as one sum of 64 bits.
fn add_wide(pixel: u32, a: u32, b: u32) {
    atomicAdd(&sums_1[pixel], u64(a) * u64(b));
}
