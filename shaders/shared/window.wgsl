// The part of the group's pixels whose translucent fragments are kept at once, and the layer that a pass looks at: 0 is the nearest.
//
// `fragments` has the nearest LAYERS fragments of each pixel, a word each as in the visibility buffer, layer by layer. Fragments sink:
// each layer keeps the greater of two words and hands the other one on, so the order in which they come does not matter (a k-buffer,
// Bavoil et al. 2007, filled by atomic maxima).
struct Window {
    first_pixel: u32,
    pixels: u32,
    layer: u32,
    unused: u32,
}

@group(0) @binding(10) var<uniform> window: Window;

const LAYERS: u32 = 8u;

// Place of a pixel in a layer.
fn place_in(layer: u32, pixel: u32) -> u32 {
    return layer * window.pixels + pixel - window.first_pixel;
}

fn is_in_window(pixel: u32) -> bool {
    return pixel - window.first_pixel < window.pixels;
}
