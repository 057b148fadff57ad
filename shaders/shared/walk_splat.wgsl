//!include VOTE
// A large splat in a band of the image: threads take its columns in turns.
fn walk_one(id: u32, rows: vec2<i32>, lane: u32) -> u32 {
    let slot = splat_slot(id >> SLOT_SHIFT);
    let splat = splat_of(slot, id & SLOT_MASK);
    let paint = paint_of(slot, paint_slot(slot), id & SLOT_MASK);
    let low = max(splat.low.y, rows.x);
    let high = min(splat.high.y, rows.y);
    var taken = 0u;
    for (var x = splat.low.x + i32(lane); x <= splat.high.x; x += LANES) {
        var y = low;
        loop {
            if y > high {
                break;
            }
            var done = true;
            let d = vec2<f32>(f32(x), f32(y)) + vec2<f32>(0.5) - splat.centre;
            let q = splat_distance(splat, d);
            if splat_meets(splat, d, q) && clip_keeps(splat.clip, d) {
                done = emit(splat, paint, frame.first_pixel + u32(y) * frame.size_px.x + u32(x), d, q);
            }
            y += i32(done);
            taken++;
        }
        taken += 2u;
    }
    return most_of_lanes(taken, walk_rounds(splat.high.x - splat.low.x, high - low)) + frame.light_count;
}
