// Lists the splats of each tile, the nearest first.
//!include shared/scene
//!include shared/tiles
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(0) @binding(8) var<storage, read_write> paint_order: array<vec2<u32>>;

@compute @workgroup_size(LANES)
fn move_tiles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    let worker = group.x * LANES + lane;
    add_up_values(lane);
    // A frame with more than there is room for is not shown.
    let fits = begins[VALUES] <= frame.paint_capacity;
    if worker == 0u {
        atomicMax(&stats[0].splats_wanted, begins[VALUES]);
        for (var tile = 0u; tile <= VALUES; tile++) {
            paint_list.tiles[tile] = select(0u, begins[tile], fits);
        }
    }
    let share = share_of(worker, select(0u, paint_list.painted, fits));
    for (var i = share.first; i < share.end; i++) {
        let entry = sorted[i];
        let tiles = tiles_of(entry.y);
        for (var row = tiles.y; row <= tiles.w; row++) {
            for (var column = tiles.x; column <= tiles.z; column++) {
                let tile = row * TILES + column;
                let at = paint_counts[tile * WORKERS + worker];
                paint_counts[tile * WORKERS + worker] = at + 1u;
                paint_order[begins[tile] + at] = entry;
            }
        }
    }
}
