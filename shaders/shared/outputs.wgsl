// Which image of the frame is wanted.
override OUTPUT: u32 = 0u;

const OUTPUT_COLOR: u32 = 0u;
const OUTPUT_DEPTH: u32 = 1u;
const OUTPUT_NORMAL: u32 = 2u;
const OUTPUT_ID: u32 = 3u;
