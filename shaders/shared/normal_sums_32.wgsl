// Sums of normals and depths for adapters without 64-bit atomics; see normal_sums_64.
@group(0) @binding(7) var<storage, read_write> sums_2: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> sums_3: array<atomic<u32>>;

fn add_2(pixel: u32, low: u32, high: u32) {
    atomicAdd(&sums_2[2u * pixel], low);
    atomicAdd(&sums_2[2u * pixel + 1u], high);
}

fn add_3(pixel: u32, low: u32, high: u32) {
    atomicAdd(&sums_3[2u * pixel], low);
    atomicAdd(&sums_3[2u * pixel + 1u], high);
}

fn add_normal(pixel: u32, normal: vec3<u32>, depth: u32) {
    add_2(pixel, normal.x, normal.y);
    add_3(pixel, normal.z, depth);
}
