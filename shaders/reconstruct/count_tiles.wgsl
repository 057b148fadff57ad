// How many splats of each worker's share reach into each tile.
//!include shared/scene
//!include shared/tiles
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;

// Lavapipe has 65535 rounds for all loops of a thread; this pass and move_tiles take as many.
const ROUNDS: u32 = 60000u;

@compute @workgroup_size(LANES)
fn count_tiles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    let worker = group.x * LANES + lane;
    let share = share_of(worker, paint_list.painted);
    begin_counts(worker);
    var rounds = 3u * VALUES;
    for (var i = share.first; i < share.end; i++) {
        let tiles = tiles_of(sorted[i].y);
        rounds += 1u + (tiles.w - tiles.y + 1u) * (tiles.z - tiles.x + 2u);
        if rounds > ROUNDS {
            atomicMax(&stats[0].splats_wanted, TOO_MANY);
            break;
        }
        for (var row = tiles.y; row <= tiles.w; row++) {
            for (var column = tiles.x; column <= tiles.z; column++) {
                paint_counts[(row * TILES + column) * WORKERS + worker]++;
            }
        }
    }
}
