// Codes of a node's error and size, and of its parent's, in units of a base; src/bake/tree/sequence.rs has the same numbers.
const CODE_BITS: u32 = 11u;
const CODE: u32 = 0x7ffu;
// The code of zero.
const NO_CODE: u32 = CODE;
// In the place of a parent's code: there is no parent.
const NO_PARENT: u32 = 0u;

// The value of a code.
fn code_value(code: u32) -> f32 {
    return select(exp2(f32(code) * -0.015625), 0.0, code == NO_CODE);
}
