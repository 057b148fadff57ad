// A scene of point trees: entries are what `select` has chosen of each instance, found again from the sums over groups of instances.
//!include shared/accepted
//!include shared/chosen
@group(1) @binding(2) var<storage, read> instance_groups: array<InstanceGroup>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> pieces: array<ChunkRun>;
@group(2) @binding(5) var<storage, read_write> entries: array<Entry>;
@group(2) @binding(6) var<storage, read> segments: array<Segment>;
@group(2) @binding(7) var<storage, read> sizes: Sizes;
@group(2) @binding(8) var<storage, read> chosen: array<u32>;
@group(2) @binding(9) var<storage, read> chosen_first: array<u32>;
@group(2) @binding(10) var<storage, read> listed: array<u32>;

// 0: errors, 1: sizes.
override MEASURE: u32 = 0u;
// Errors are those of the angle that a node is seen at.
override SPLIT: bool = false;

const NOBODY: Entry = Entry(0xffffffffu, 0u);

fn entry_count() -> u32 {
    return sizes.group_count * 32u;
}

// Where a walk over entries is: up to `end` they are chunks of one instance, one behind the other.
struct Walk {
    at: u32,
    end: u32,
    instance: u32,
    chunk: u32,
}

fn walk_from(first: u32) -> Walk {
    return Walk(first, first, NOBODY.instance, 0u);
}

// Looks up whose entry the walk is at.
fn walk_find(walk: ptr<function, Walk>) {
    let e = (*walk).at;
    var segment = 0u;
    while segment + 1u < sizes.segment_count && segments[segment].end_group * 32u <= e {
        segment++;
    }
    // The last listed group that begins no later; what is behind its last entry is padding.
    let row = segment * frame.instance_groups;
    var low = 0u;
    var high = listed[0];
    while low + 1u < high {
        let middle = (low + high) / 2u;
        if chosen_first[row + middle] <= e {
            low = middle;
        } else {
            high = middle;
        }
    }
    let begin = chosen_first[row + low];
    let group = instance_groups[listed[1u + low]];
    let own = (row + low) * CHOSEN;
    var member = 0u;
    while member + 1u < group.count && begin + chosen[own + member + 1u] <= e {
        member++;
    }
    let index = group.first + member;
    let piece = pieces[instances[index].geometry * sizes.segment_count + segment];
    let offset = e - begin - chosen[own + member];
    let count = chosen[own + member + 1u] - chosen[own + member];
    if e < begin || offset >= count {
        (*walk).instance = NOBODY.instance;
        (*walk).end = e + 1u;
        return;
    }
    (*walk).instance = index;
    (*walk).chunk = piece.first + offset;
    (*walk).end = e + count - offset;
}

fn walk_next(walk: ptr<function, Walk>) -> Entry {
    if (*walk).at >= (*walk).end {
        walk_find(walk);
    }
    let entry = Entry((*walk).instance, (*walk).chunk);
    entries[(*walk).at] = entry;
    (*walk).at++;
    (*walk).chunk++;
    return entry;
}

// How far nodes are drawn beside their pixels, where that does not follow from their kernels.
fn node_px() -> f32 {
    return select(0.0, lod_px(), MEASURE == 1u);
}

// Whether some node of a chunk may be drawn. `scale`: of cells to camera space; `low`, `high`: depths of its box; `far`: no point of
// it is farther from the eye.
fn chunk_is_wanted(chunk: Chunk, scale: f32, low: f32, high: f32, far: f32) -> bool {
    let parent = select(chunk.error_parent, chunk.size_parent, MEASURE == 1u);
    let least = select(chunk.error_least, chunk.size_least, MEASURE == 1u) * select(1.0, SIDEWAYS, SPLIT);
    let delta = scale * chunk.delta_most + DEPTH_SLACK * far;
    return scale * parent > accepted(low - delta, far + delta) && scale * least <= accepted(high + DEPTH_SLACK * far, high);
}
