// A thread takes a sample, makes a splat of it and walks the pixels of its box; large ones are listed. The file that includes this
// says what happens at a pixel: `emit`, with what `paint_of` gives it for the whole splat.
//
// On lavapipe all loops of a thread, and of those that go with it, share 65535 rounds, and what comes after is never done. So threads
// keep account of theirs, and list what they have none left for.
//!include shared/list
//!include shared/gather
const ROUNDS: u32 = 60000u;

fn mark_full() {
    atomicMax(&stats[frame.view].sums_full, 1u);
}

var<private> shared_paint: PaintSlot;

fn begin_slot(slot: SplatSlot) {
    shared_paint = paint_slot(slot);
}

fn take(slot: SplatSlot, i: u32, tally: ptr<function, Tally>) {
    let longest = u32(frame.small_splat_px) + 1u;
    let width = frame.size_px.x;
    let splat = splat_of(slot, i);
    // The part of its box that the pass draws.
    let rows = vec2<i32>(drawn_rows());
    let low = vec2<i32>(splat.low.x, max(splat.low.y, rows.x));
    let high = vec2<i32>(splat.high.x, min(splat.high.y, rows.y - 1));
    let holds = all(high >= low);
    // A splat counts in the window where its box begins.
    let begins = u32(low.y == splat.low.y);
    let box = vec2<u32>(high - low + vec2<i32>(1));
    let is_small = splat.way == SMALL && holds;
    let pixels = select(0u, box.x * box.y, is_small);
    let full = (*tally).rounds + most_of_lanes(pixels, longest * longest) > ROUNDS;
    if splat.way == LARGE && holds {
        list_large(splat.id, vec2<u32>(low), vec2<u32>(high));
        (*tally).listed += begins;
        (*tally).crossing += begins * u32(splat.crosses);
    }
    if is_small && full {
        list_entry(splat.id, vec2<u32>(low), vec2<u32>(high));
        (*tally).listed += begins;
    }
    var taken = 0u;
    if is_small && !full {
        (*tally).scattered += begins;
        let paint = paint_of(slot, shared_paint, i);
        var at = low;
        // One loop over both directions: threads of a vector end together where their boxes are alike in area.
        loop {
            let d = vec2<f32>(at) + vec2<f32>(0.5) - splat.centre;
            let q = splat_distance(splat, d);
            var done = true;
            if splat_meets(splat, d, q) && clip_keeps(splat.clip, d) {
                done = emit(splat, paint, frame.first_pixel + u32(at.y) * width + u32(at.x), d, q);
            }
            taken++;
            if done {
                at.x++;
            }
            if at.x > high.x {
                at = vec2<i32>(low.x, at.y + 1);
            }
            if at.y > high.y {
                break;
            }
        }
    }
    (*tally).rounds += most_of_lanes(taken, longest * longest) + frame.light_count + 1u;
}

fn scatter(group: vec3<u32>, lane: u32) {
    let tally = gather(group, lane);
    if COUNTS {
        if TREE && tally.looked_at != 0u {
            count_samples(tally.looked_at);
        }
        if tally.scattered != 0u {
            atomicAdd(&stats[frame.view].splats_scattered, tally.scattered);
        }
        if tally.listed != 0u {
            atomicAdd(&stats[frame.view].splats_listed, tally.listed);
            atomicAdd(&stats[frame.view].splats_clipped, tally.crossing);
        }
    }
}
