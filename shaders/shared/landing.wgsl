// Where a sample lies in the image, and the one pixel that it is drawn in.
//!include shared/kernel

// Samples stand for disks, from which pull-push reconstructs the surface: a sample beside the image whose disk may reach into the image is
// drawn in the rim, which is one pixel wide and surrounds the image. There it hides nothing that the image shows.
override EXPANDED: bool = false;

// A sample's position in the image.
struct Place {
    image: vec2<f32>,
    z: f32,
    inverse: f32,
}

fn place_of(word: vec2<u32>, row_x: vec4<f32>, row_y: vec4<f32>, row_z: vec4<f32>) -> Place {
    let q = sample_cell(word);
    let z = fma(row_z.x, q.x, fma(row_z.y, q.y, fma(row_z.z, q.z, row_z.w)));
    let inverse = 1.0 / z;
    let by = select(inverse, 1.0, ORTHOGRAPHIC);
    let x = fma(row_x.x, q.x, fma(row_x.y, q.y, fma(row_x.z, q.z, row_x.w))) * by;
    let y = fma(row_y.x, q.x, fma(row_y.y, q.y, fma(row_y.z, q.z, row_y.w))) * by;
    return Place(vec2<f32>(x, y), z, inverse);
}

// Half of what a sample's disk covers at most, in pixels along both axes. `longest`: the chunk's longest axis in camera space.
fn disk_px(sample: u32, longest: f32, z: f32) -> vec2<f32> {
    let lengths = axis_lengths(kernels[sample * KERNEL_WORDS], longest);
    return frame.splat_cutoff * frame.splat_width * max(lengths.x, lengths.y) * frame.focal_px / divisor(z);
}

// The area that a node's disk fills in the image, of which so much is seen; no less than a pixel.
fn footprint_px(sample: u32, longest: f32, z: f32, seen: f32) -> f32 {
    let radius = disk_px(sample, longest, z);
    let counted = min(max(radius.x, radius.y), MOST_THINNED_PX);
    return max(3.1415927 * counted * counted * seen, 1.0);
}

const NO_PIXEL: u32 = 0xffffffffu;

// The pixel of the image or of the rim that is nearest to a place.
fn landing_pixel(image: vec2<f32>) -> vec2<i32> {
    return vec2<i32>(clamp(floor(image), vec2<f32>(-1.0), vec2<f32>(frame.size_px)));
}

// Where the visibility buffer has a pixel of the rim: behind the images of all views. A rim's rows come first, then what lies left and right
// of each row of the image.
fn rim_place(pixel: vec2<i32>) -> u32 {
    let size = vec2<i32>(frame.size_px);
    var place = select(size.x + 2, 0i, pixel.y < 0) + pixel.x + 1;
    if pixel.y >= 0 && pixel.y < size.y {
        place = 2 * (size.x + 2 + pixel.y) + select(1i, 0i, pixel.x < 0);
    }
    let rim = 2 * (size.x + size.y + 2);
    return frame.views * frame.size_px.x * frame.size_px.y + frame.view * u32(rim) + u32(place);
}

// The place in the visibility buffer of the pixel that a sample is drawn in.
fn landing(at: Place, sample: u32, longest: f32) -> u32 {
    if !(at.z > NEAREST) {
        return NO_PIXEL;
    }
    let size = vec2<f32>(frame.size_px);
    let is_inside = all(at.image >= vec2<f32>(0.0)) && all(at.image < size);
    if !is_inside {
        if !EXPANDED {
            return NO_PIXEL;
        }
        let reach = disk_px(sample, longest, at.z);
        if any(at.image + reach <= vec2<f32>(0.0)) || any(at.image - reach >= size) {
            return NO_PIXEL;
        }
    }
    if !place_is_shown(at_depth(at.image, at.z)) {
        return NO_PIXEL;
    }
    if EXPANDED && !is_inside {
        return rim_place(landing_pixel(at.image));
    }
    return frame.first_pixel + u32(at.image.y) * frame.size_px.x + u32(at.image.x);
}

// Length in camera space of a chunk's longest axis, by the columns of the map from its coordinates.
fn longest_axis(base: f32, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>) -> f32 {
    return base * stretch_of(x, y, z);
}
