// The words that passes over the image look at: those of a layer of translucent fragments.
//!include shared/window
@group(0) @binding(1) var<storage, read> fragments: array<vec2<u32>>;

fn low_word(pixel: u32) -> u32 {
    return fragments[place_in(window.layer, pixel)].x;
}

fn high_word(pixel: u32) -> u32 {
    if !is_in_window(pixel) {
        return 0u;
    }
    return fragments[place_in(window.layer, pixel)].y;
}

// No pixel has a fragment in this layer if none has one in the layer before.
fn words_are_left() -> bool {
    return atomicLoad(&stats[frame.view].layers) >= window.layer;
}

// Notes that some pixel has a fragment in this layer.
fn note_layer() {
    atomicMax(&stats[frame.view].layers, window.layer + 1u);
}
