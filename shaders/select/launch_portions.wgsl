// Starts the next turn with the slots listed since the last turn, and sizes the indirect dispatches that draw these slots
// and test far ones. Each dispatch is large enough for the view with the most slots.
//!include shared/frame
//!include shared/scene
//!include shared/portions
//!include shared/pyramid
//!include shared/launch

@group(2) @binding(0) var<storage, read_write> portions: array<Portion>;
@group(2) @binding(1) var<storage, read_write> dispatches: array<Dispatch>;
@group(2) @binding(2) var<storage, read_write> depths: array<u32>;

// All listed slots are drawn in one turn, or tested again.
override WHOLE: bool = false;

@compute @workgroup_size(1)
fn launch_portions() {
    begin_view(0u);
    // See all_lights in shared/phong for why bounds are no uniforms alone.
    let segments = min(frame.segment_count, arrayLength(&dispatches));
    let views = min(frame.views, arrayLength(&portions));
    // Number of slots that the next turn tests, over all views.
    var next = 0u;
    for (var view = 0u; view < views && !WHOLE; view++) {
        let record = view * DEPTHS_WORDS;
        let turn = depths[record + DEPTH_TURN] + 1u;
        depths[record + DEPTH_TURN] = turn;
        next += depths[record + DEPTH_ASKED + min(turn, TURNS + 1u)];
    }
    var asked = 0u;
    for (var segment = 0u; segment < segments; segment++) {
        var far = 0u;
        var listed = 0u;
        for (var view = 0u; view < views; view++) {
            let at = view * segments + segment;
            far = max(far, select(0u, atomicLoad(&portions[at].far), next > 0u));
            let begin = select(portions[at].end, 0u, WHOLE);
            let end = atomicLoad(&portions[at].listed);
            portions[at].begin = begin;
            portions[at].end = end;
            listed = max(listed, end - begin);
            // A view whose slots are all near has asked nothing, and asks nothing again.
            if WHOLE && depths[view * DEPTHS_WORDS + DEPTH_ENDS] < DEPTH_BINS {
                far = max(far, end);
            }
        }
        set_launch(segments + segment, (far + ASKED - 1u) / ASKED, views);
        set_launch(2u * segments + segment, listed, views);
        asked = max(asked, far);
    }
    let blocks = pyramid_blocks();
    set_launch(3u * segments, select(0u, (blocks.x * blocks.y + 63u) / 64u, asked > 0u), views);
}
