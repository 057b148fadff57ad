// Agreements of the passes that list the chunks of point trees: sums, and launches behind those of the segments.
struct Sizes {
    group_count: u32,
    segment_count: u32,
}

// Numbers that are kept of a group of instances: where each one's chunks begin, and where the last one's end.
const CHOSEN: u32 = INSTANCE_GROUP + 1u;

const LOD_LAUNCHES: u32 = 4u;
const LAUNCH_PLACE: u32 = 0u;
const LAUNCH_SELECT: u32 = 1u;
const LAUNCH_CULL: u32 = 2u;
const LAUNCH_COMPACT: u32 = 3u;
