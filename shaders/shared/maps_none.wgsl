// Materials have no maps beside those of their colours.
fn keep_maps(pixel: u32, surface: Surface) {
}

fn recall_maps(pixel: u32, surface: ptr<function, Surface>) {
}
