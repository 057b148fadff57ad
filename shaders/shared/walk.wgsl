// Goes through the list of large triangles or splats: eight threads, a CPU's vector, take an entry in a band of the image. The
// file that includes this says what they do with it: `walk_one`, for the rows that are given, and how many rounds of loops it took.
//
// On lavapipe all loops of a thread share 65535 rounds, and what comes after is never done. A workgroup that has no rounds left
// says so, and the frame is drawn again by more workgroups.
@group(0) @binding(4) var<storage, read_write> stats: array<atomic<u32>>;
@group(2) @binding(4) var<storage, read> large: array<u32>;

// Height of the bands into which the image is cut.
override BAND: i32 = 128;
const LANES: i32 = 8;
// Before an entry is begun; the widest takes as many again, see `passes::project::walk`.
const ROUNDS: u32 = 30000u;

// Bounds the rounds of a walk over a box that reaches so far beyond its first column and row.
fn walk_rounds(columns: i32, rows: i32) -> u32 {
    return select(0u, u32(columns / LANES + 1) * u32(rows + 2), min(columns, rows) >= 0);
}

fn mark_full() {
    atomicMax(&stats[frame.view * STATS_WORDS + STAT_SUMS_FULL], 1u);
}

// `stride`: entries that go side by side.
fn walk_list(group: vec3<u32>, stride: u32, lane: u32) {
    begin_view(0u);
    let count = select(0u, large[0] / 3u, list_is_whole(atomicLoad(&stats[STAT_LARGE_LONGEST])));
    let height = i32(frame.size_px.y);
    let first = i32(group.y) * BAND;
    let last = min(first + BAND, height) - 1;
    var i = group.x;
    var rounds = 0u;
    loop {
        // On to the next entry of this band, before any expensive work: see shared/resolve.
        var rows_of = vec2<i32>(0);
        var word = 0u;
        loop {
            if i >= count || rounds > ROUNDS {
                break;
            }
            rounds++;
            word = large[LIST_HEAD + i * LIST_ENTRY + 1u];
            let rows = list_rows(word);
            rows_of = vec2<i32>(max(rows.x, first), min(rows.y, last));
            let counters = list_view(word) * STATS_WORDS;
            if rows_of.x <= rows_of.y && may_draw(atomicLoad(&stats[counters + STAT_LARGE_UNITS]), atomicLoad(&stats[counters + STAT_LARGE_WRAPPED])) {
                break;
            }
            i += stride;
        }
        if i >= count {
            break;
        }
        if rounds > ROUNDS {
            atomicMax(&stats[STAT_WALK_CUT], 1u);
            break;
        }
        begin_view(list_view(word));
        rounds += walk_one(large[LIST_HEAD + i * LIST_ENTRY], rows_of, lane) + 1u;
        i += stride;
    }
}
