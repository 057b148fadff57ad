// Goes through the list of large triangles or splats: eight threads, a CPU's vector, take an entry in a band of the image. The
// file that includes this says what they do with it: `walk_one`, for the rows that are given.
@group(0) @binding(4) var<storage, read_write> stats: array<atomic<u32>>;
@group(2) @binding(4) var<storage, read> large: array<u32>;

// Entries that go side by side, and the height of the bands into which the image is cut.
const STRIDE: u32 = 64u;
const BAND: i32 = 128;
const LANES: i32 = 8;

fn mark_full() {
    atomicMax(&stats[frame.view * STATS_WORDS + STAT_SUMS_FULL], 1u);
}

fn walk_list(group: vec3<u32>, lane: u32) {
    begin_view(0u);
    let count = select(0u, large[0] / 3u, list_is_whole(atomicLoad(&stats[STAT_LARGE_LONGEST])));
    let height = i32(frame.size_px.y);
    let first = i32(group.y) * BAND;
    let last = min(first + BAND, height) - 1;
    var i = group.x;
    loop {
        // On to the next entry of this band, before anything dear is done: see shared/resolve.
        var rows = vec2<i32>(0);
        var word = 0u;
        loop {
            if i >= count {
                break;
            }
            word = large[LIST_HEAD + i * LIST_ENTRY + 1u];
            rows = list_rows(word);
            rows = vec2<i32>(max(rows.x, first), min(rows.y, last));
            let counters = list_view(word) * STATS_WORDS;
            if rows.x <= rows.y && may_draw(atomicLoad(&stats[counters + STAT_LARGE_UNITS]), atomicLoad(&stats[counters + STAT_LARGE_WRAPPED])) {
                break;
            }
            i += STRIDE;
        }
        if i >= count {
            break;
        }
        begin_view(list_view(word));
        walk_one(large[LIST_HEAD + i * LIST_ENTRY], rows, lane);
        i += STRIDE;
    }
}
