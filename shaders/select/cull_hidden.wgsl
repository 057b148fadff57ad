// Occlusion test of the far slots in this turn: each of their parts is tested against what has been drawn. Visible slots are listed with the
// parts that are not hidden. On CPU adapters a thread takes several slots. On GPUs a slot has several threads, which test parts side by side.
//!include shared/frame
//!include shared/scene
//!include shared/frustum
//!include shared/portions
//!include shared/tested
//!include shared/pyramid
//!include shared/parts

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;
@group(2) @binding(4) var<storage, read> pyramid: array<u32>;
@group(2) @binding(5) var<storage, read_write> portions: array<Portion>;
@group(2) @binding(6) var<storage, read> turns: array<u32>;
@group(2) @binding(7) var<storage, read_write> turn_slots: array<vec2<u32>>;
@group(2) @binding(8) var<storage, read> depths: array<u32>;

// Samples count themselves as they are tested.
override COUNTS_SAMPLES: bool = false;
// Tests slots that have already been drawn.
override AGAIN: bool = false;
// Samples are drawn as splats.
override SPLATS: bool = false;
// Samples beside the image are drawn in its rim, where nothing hides them; see shared/landing.
override EXPANDED: bool = false;
// Splats of all samples are discs of one size.
override DISCS: bool = false;

// Threads that share a slot; with one, each thread takes ASKED / 64 slots.
override TESTERS: u32 = 1u;

// Largest number of tiles, or of blocks, that are read in each direction.
const MOST_ACROSS: u32 = 6u;
// Boxes up to this many pixels are tested pixel by pixel.
const MOST_PIXELS: u32 = 8u;

// Whether every pixel within bounds shows something nearer. `expanded`: what lies beside the image is drawn as well.
fn is_hidden(bounds: BoxBounds, expanded: bool) -> bool {
    let size = vec2<f32>(frame.size_px);
    if any(bounds.most < vec2<f32>(0.0)) || any(bounds.least > size) {
        return true;
    }
    let is_beside = any(bounds.least < vec2<f32>(0.0)) || any(bounds.most > size);
    if bounds.near == 0.0 || (expanded && is_beside) {
        return false;
    }
    let low = vec2<u32>(clamp(bounds.least, vec2<f32>(0.0), size - vec2<f32>(1.0)));
    let high = vec2<u32>(clamp(bounds.most, vec2<f32>(0.0), size - vec2<f32>(1.0)));
    // Allows for rounding of 1/z, here and where it was written.
    let nearest = bitcast<u32>(1.00001 / bounds.near);
    let by_pixels = all(high - low < vec2<u32>(MOST_PIXELS));
    let by_tiles = all(high / TILE_PX - low / TILE_PX < vec2<u32>(MOST_ACROSS));
    let unit = select(select(BLOCK_PX, TILE_PX, by_tiles), 1u, by_pixels);
    let first = low / unit;
    let last = high / unit;
    if !by_pixels && any(last - first >= vec2<u32>(MOST_ACROSS)) {
        return false;
    }
    var at = first;
    loop {
        var shown = 0u;
        if by_pixels {
            shown = visibility[frame.first_pixel + at.y * frame.size_px.x + at.x].y;
        } else if by_tiles {
            let tile = at % BLOCK_TILES;
            shown = pyramid[block_record(at / BLOCK_TILES) + 1u + tile.y * BLOCK_TILES + tile.x];
        } else {
            shown = pyramid[block_record(at)];
        }
        if shown <= nearest {
            return false;
        }
        at.x++;
        if at.x > last.x {
            at = vec2<u32>(first.x, at.y + 1u);
        }
        if at.y > last.y {
            break;
        }
    }
    return true;
}

// Returns which of a slot's parts are not hidden: of all of them, or of those of one of TESTERS threads.
fn shown_parts(slot: Slot, chunk: Chunk, tester: u32) -> u32 {
    let at = placed[frame.first_instance + slot.instance];
    let whole = grid_box(at, chunk.origin, chunk.extent);
    let is_splats = SPLATS && chunk.kind == SAMPLES;
    let expanded = EXPANDED && chunk.kind == SAMPLES;
    let is_lines = chunk.kind == SEGMENTS;
    // Lines of a part may be thinner than all others of the chunk, but none is thinner than asked for.
    let least_reach = select(0.0, least_line_reach(whole), is_lines);
    let reach = select(select(0.0, splat_reach(chunk, stretch(at)), is_splats), line_reach(chunk, stretch(at), whole), is_lines);
    // A splat fills at least one pixel, and what is drawn of a node as points or as a disc reaches as far as its error.
    let is_node = chunk.kind == SAMPLES && chunk.node_base > 0.0 && (DISCS || !SPLATS);
    let node_px = select(0.0, frame.lod_scale * max(frame.focal_px.x, frame.focal_px.y), is_node);
    let splat_px = select(0.0, max(frame.splat_cutoff * frame.splat_lowpass_px, 1.0), is_splats);
    let filter_px = select(max(splat_px, node_px), LINE_FILTER_PX, is_lines);
    let widened = Box(whole.centre, whole.x, whole.y, whole.z, whole.slack + reach);
    let count = (chunk.count + PART - 1u) / PART;
    // The test of a whole slot saves those of its parts, unless they are made side by side.
    let stop = select(count, 0u, TESTERS == 1u && is_hidden(drawn_bounds(widened, filter_px), expanded));
    var shown = 0u;
    for (var own = tester; own < stop; own += TESTERS) {
        if ((slot.parts >> own) & 1u) == 0u {
            continue;
        }
        let low = parts[slot.chunk][own].low;
        var part = part_box(whole, low, parts[slot.chunk][own].high);
        part.slack += max(reach * select(longest_of(low), 1.0, DISCS && !is_lines), least_reach);
        if !is_hidden(drawn_bounds(part, filter_px), expanded) {
            shown |= 1u << own;
        }
    }
    return shown;
}

// Lists a slot for drawing in this turn if any part of it is visible.
fn list_slot(run: Run, slot_index: u32, shown: u32) {
    if shown == 0u {
        return;
    }
    let chunk = chunks[slots[frame.first_slot + slot_index].chunk];
    // The last part may be shorter.
    let last = (chunk.count - 1u) / PART;
    let elements = countOneBits(shown) * PART - select(0u, (last + 1u) * PART - chunk.count, (shown >> last) == 1u);
    if chunk.kind == TRIANGLES {
        count_triangles(elements);
    } else if chunk.kind == SEGMENTS {
        count_segments(elements);
    } else if COUNTS_SAMPLES {
        count_samples(elements);
    }
    let place = atomicAdd(&portions[frame.first_run + segment.index].listed, 1u);
    turn_slots[frame.first_slot + run.first_slot + place] = vec2<u32>(slot_index, shown);
}

// Which slots are asked: in this turn those whose depths are in these bins, or those that have been drawn.
struct Asked {
    count: u32,
    first: u32,
    begin: u32,
    end: u32,
}

fn asked_slots(run: Run) -> Asked {
    let own = frame.first_run + segment.index;
    let first = frame.first_slot + run.first_slot;
    if AGAIN {
        return Asked(atomicLoad(&portions[own].listed), first, 0u, 0u);
    }
    let record = frame.view * DEPTHS_WORDS;
    let ends = record + DEPTH_ENDS + clamp(depths[record + DEPTH_TURN], 1u, TURNS);
    return Asked(atomicLoad(&portions[own].far), first, depths[ends - 1u], depths[ends]);
}

// Returns a slot, if it is asked in this turn, else NO_TURN.
fn slot_in_turn(asked: Asked, index: u32) -> u32 {
    let word = turns[asked.first + index];
    let bin = word >> TURN_SHIFT;
    return select(NO_TURN, word & TURN_SLOT, word != NO_TURN && bin >= asked.begin && bin < asked.end);
}

fn shown_of(slot_index: u32, tester: u32) -> u32 {
    let slot = slots[frame.first_slot + slot_index];
    return shown_parts(slot, chunks[slot.chunk], tester);
}

// What the threads of each slot of this workgroup have found.
var<workgroup> found: array<atomic<u32>, 64>;

// Asks a slot, each of its threads some parts.
fn ask_together(group: u32, lane: u32) {
    let run = runs[frame.first_run + segment.index];
    let asked = asked_slots(run);
    let place = lane / TESTERS;
    let tester = lane % TESTERS;
    let index = group * ASKED + place;
    var slot = NO_TURN;
    if index < asked.count {
        if AGAIN {
            slot = turn_slots[asked.first + index].x;
        } else {
            slot = slot_in_turn(asked, index);
        }
    }
    // Pipelines do not empty the memory of workgroups.
    if tester == 0u {
        atomicStore(&found[place], 0u);
    }
    workgroupBarrier();
    if slot != NO_TURN {
        atomicOr(&found[place], shown_of(slot, tester));
    }
    workgroupBarrier();
    if slot == NO_TURN || tester != 0u {
        return;
    }
    let shown = atomicLoad(&found[place]);
    if AGAIN {
        turn_slots[asked.first + index].y &= shown;
    } else {
        list_slot(run, slot, shown);
    }
}

// Asks several slots, one after the other.
fn ask_alone(thread: u32) {
    let run = runs[frame.first_run + segment.index];
    let asked = asked_slots(run);
    var index = thread * (ASKED / 64u);
    let stop = min(index + ASKED / 64u, asked.count);
    if AGAIN {
        // Removes from drawn slots the parts that later draws have hidden.
        for (; index < stop; index++) {
            let word = turn_slots[asked.first + index];
            turn_slots[asked.first + index].y = word.y & shown_of(word.x, 0u);
        }
        return;
    }
    loop {
        // Seeks the next slot of this turn before any expensive work is done: see shared/resolve.
        var slot = NO_TURN;
        while index < stop && slot == NO_TURN {
            slot = slot_in_turn(asked, index);
            index++;
        }
        if slot == NO_TURN {
            break;
        }
        list_slot(run, slot, shown_of(slot, 0u));
    }
}

@compute @workgroup_size(64)
fn cull_hidden(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(global_invocation_id) invocation: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    begin_view(invocation.z);
    if TESTERS > 1u {
        ask_together(workgroup.x + workgroup.y * DISPATCH_ROW, lane);
    } else {
        ask_alone(invocation.x + invocation.y * DISPATCH_ROW * 64u);
    }
}
