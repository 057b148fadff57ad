// How the passes are launched that draw near slots, ask far ones and draw what is left of these: enough for the view with the most.
//!include shared/frame
//!include shared/scene
//!include shared/portions
//!include shared/pyramid
//!include shared/launch

@group(2) @binding(0) var<storage, read_write> portions: array<Portion>;
@group(2) @binding(1) var<storage, read_write> dispatches: array<Dispatch>;

// All that is not hidden is drawn in one turn.
override WHOLE: bool = false;

@compute @workgroup_size(1)
fn launch_portions() {
    begin_view(0u);
    // See shade for why bounds are no uniforms alone.
    let segments = min(frame.segment_count, arrayLength(&dispatches));
    let views = min(frame.views, arrayLength(&portions));
    var asked = 0u;
    for (var segment = 0u; segment < segments; segment++) {
        var near = 0u;
        var far = 0u;
        var late = 0u;
        for (var view = 0u; view < views; view++) {
            let at = view * segments + segment;
            near = max(near, atomicLoad(&portions[at].near));
            far = max(far, atomicLoad(&portions[at].far));
            if WHOLE {
                atomicStore(&portions[at].before, 0u);
            }
            late = max(late, atomicLoad(&portions[at].late) - atomicLoad(&portions[at].before));
        }
        set_launch(segments + segment, near, views);
        set_launch(2u * segments + segment, (far + 64u * ASKED_EACH - 1u) / (64u * ASKED_EACH), views);
        set_launch(3u * segments + segment, late, views);
        asked = max(asked, far);
    }
    let blocks = pyramid_blocks();
    set_launch(4u * segments, select(0u, (blocks.x * blocks.y + 63u) / 64u, asked > 0u), views);
}
