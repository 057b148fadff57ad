//! Scalar fields of packed samples and lines: where a field's codes are, and how the nodes of trees and levels of lines combine them.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::kind::holds;
use crate::assets::fields::{CLASSIFICATION, MOST_NAME_BYTES, MOST_WORDS, Scale};
use crate::assets::{Field, Fields};
use crate::scene::fields::class_number;

/// The codes of the fields of a sample or of a vertex of a line.
pub type Values = [u32; MOST_WORDS];
/// Words of a [`PackedField`].
pub(super) const FIELD_WORDS: usize = size_of::<PackedField>() / 4;
/// A colour map shows the values between these fractions of all points by default.
const SHOWN: [f64; 2] = [0.01, 0.99];

/// A scalar field of packed samples or lines.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PackedField {
    /// UTF-8, followed by zeros.
    name: [u8; MOST_NAME_BYTES],
    /// Bits of [`Scale::least`] and [`Scale::step`], lower word first.
    least: [u32; 2],
    step: [u32; 2],
    /// [`Scale::most`] and [`Scale::has_gaps`].
    most: u32,
    has_gaps: u32,
    /// Lowest bit of the code, counted through the words of a sample.
    place: u32,
    /// Codes of the 1st and the 99th percentile.
    shown: [u32; 2],
    /// Bit `c` tells that some point has the class `c`; zero for fields that are not classes.
    classes: [u32; 8],
}

fn split(value: f64) -> [u32; 2] {
    let bits = value.to_bits();
    [bits as u32, (bits >> 32) as u32]
}

fn joined([low, high]: [u32; 2]) -> f64 {
    f64::from_bits(u64::from(low) | u64::from(high) << 32)
}

/// Whether a field has classes, which have no mean.
fn is_class(name: &str, scale: &Scale) -> bool {
    name == CLASSIFICATION && scale.step == 1.0 && scale.least.abs() < f64::from(i32::MAX)
}

impl PackedField {
    pub fn name(&self) -> &str {
        let length = self.name.iter().position(|&byte| byte == 0).unwrap_or(MOST_NAME_BYTES);
        std::str::from_utf8(&self.name[..length]).unwrap_or_default()
    }

    pub fn scale(&self) -> Scale {
        let (least, step) = (joined(self.least), joined(self.step));
        Scale { least, step, most: self.most as u16, has_gaps: self.has_gaps != 0 }
    }

    /// Lowest bit of the code, counted through the words of a sample.
    pub fn place(&self) -> u32 {
        self.place
    }

    pub fn is_class(&self) -> bool {
        is_class(self.name(), &self.scale())
    }

    /// The values that a colour map shows by default: those of the 1st and of the 99th percentile.
    pub fn shown(&self) -> [f64; 2] {
        let scale = self.scale();
        self.shown.map(|code| scale.least + scale.step * f64::from(code))
    }

    /// The smallest and the largest value.
    pub fn range(&self) -> [f64; 2] {
        let scale = self.scale();
        [scale.least, scale.least + scale.step * f64::from(scale.most)]
    }

    /// The classes that points have.
    pub fn classes(&self) -> impl Iterator<Item = u8> {
        let words = self.classes;
        (0..=255u8).filter(move |&class| words[usize::from(class) / 32] >> (class % 32) & 1 != 0)
    }

    /// The field of a cloud that was packed to this one.
    pub fn field(&self) -> Field {
        Field { name: self.name().to_owned(), scale: self.scale(), place: self.place }
    }

    /// The value of a sample with these words; `None` where it has none.
    pub fn value(&self, words: &[u32]) -> Option<f64> {
        self.field().value(words)
    }

    /// See [`Field::between`].
    pub fn between(&self, vertices: [&[u32]; 2], share: f64) -> Option<f64> {
        self.field().between(vertices, share, self.is_class())
    }
}

/// How many points have each code.
#[derive(Clone, Debug, Default)]
pub(in crate::bake) struct CodeCounts(Vec<u64>);

impl CodeCounts {
    /// Adds the codes of all points of a field.
    pub(in crate::bake) fn add(&mut self, field: &Field, fields: &Fields) {
        let empty = || vec![0u64; usize::from(u16::MAX) + 1];
        let part = |mut counts: Vec<u64>, words: &[u32]| {
            for words in words.chunks_exact(fields.width()) {
                counts[usize::from(field.code(words))] += 1;
            }
            counts
        };
        let sum = |mut a: Vec<u64>, b: Vec<u64>| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        };
        let parts = fields.words().par_chunks(fields.width().max(1) << 18);
        let found = parts.fold(empty, part).reduce(empty, sum);
        self.0 = if self.0.is_empty() { found } else { sum(std::mem::take(&mut self.0), found) };
    }

    /// Codes of values, each with the number of points that have it.
    pub(in crate::bake) fn of(&self, scale: &Scale) -> impl Iterator<Item = (u16, u64)> + Clone {
        let codes = self.0.iter().zip(0..=scale.most).map(|(&count, code)| (code, count));
        codes.filter(|&(_, count)| count > 0)
    }

    /// The code below which a fraction of all values lie; `None` without values.
    pub(in crate::bake) fn percentile(&self, scale: &Scale, fraction: f64) -> Option<u16> {
        let total: u64 = self.of(scale).map(|(_, count)| count).sum();
        let rank = ((total as f64 - 1.0) * fraction).round() as u64;
        let mut below = 0;
        let mut codes = self.of(scale);
        codes.find_map(|(code, count)| {
            below += count;
            (below > rank).then_some(code)
        })
    }
}

/// A field of samples, given the number of points that have each code.
pub(in crate::bake) fn pack_field(field: &Field, counts: &CodeCounts) -> PackedField {
    let Field { name, scale, place } = field;
    let mut bytes = [0; MOST_NAME_BYTES];
    // Longer names are left out by readers.
    let length = name.len().min(MOST_NAME_BYTES);
    bytes[..length].copy_from_slice(&name.as_bytes()[..length]);
    let mut classes = [0; 8];
    for (code, _) in counts.of(scale).filter(|_| is_class(name, scale)) {
        let class = class_number(scale.least + scale.step * f64::from(code));
        classes[usize::from(class) / 32] |= 1 << (class % 32);
    }
    let shown = SHOWN.map(|part| counts.percentile(scale, part).unwrap_or_default().into());
    PackedField {
        name: bytes,
        least: split(scale.least),
        step: split(scale.step),
        most: scale.most.into(),
        has_gaps: scale.has_gaps.into(),
        place: *place,
        shown,
        classes,
    }
}

/// The fields of points or vertices, packed.
pub(in crate::bake) fn pack_fields(fields: &Fields) -> Vec<PackedField> {
    let pack = |field: &Field| {
        let mut counts = CodeCounts::default();
        counts.add(field, fields);
        pack_field(field, &counts)
    };
    fields.list().iter().map(pack).collect()
}

/// The words of a point's or a vertex's values.
pub(in crate::bake) fn values_at(fields: &Fields, point: usize) -> Values {
    let mut values = Values::default();
    if !fields.is_empty() {
        values.iter_mut().zip(fields.at(point)).for_each(|(value, word)| *value = *word);
    }
    values
}

/// Checks the fields of so many elements, and how many words of values there are.
///
/// # Errors
/// Returns the first violation.
pub(super) fn check_fields(
    fields: &[PackedField],
    elements: usize,
    values: usize,
) -> Result<(), &'static str> {
    let words = value_words(fields);
    holds(words <= MOST_WORDS, "a field lies beyond the words of an element")?;
    holds(values == words * elements, "there are not as many values as positions")?;
    let is_field = |field: &PackedField| {
        let Scale { least, step, most, .. } = field.scale();
        let bits = field.scale().bits();
        least.is_finite()
            && step.is_finite()
            && step > 0.0
            && u32::from(most) == field.most
            && bits + field.place % 32 <= 32
    };
    holds(fields.iter().all(is_field), "a field has no valid scale")
}

/// Words that the values of a sample with these fields take.
pub fn value_words(fields: &[PackedField]) -> usize {
    fields.iter().map(|field| field.place as usize / 32 + 1).max().unwrap_or(0)
}

/// The bits of the codes, which is all that combining them needs.
#[derive(Clone, Debug, Default)]
pub struct Layout(Vec<Slot>);

#[derive(Clone, Copy, Debug)]
struct Slot {
    word: usize,
    shift: u32,
    mask: u32,
    /// Codes above mean that a sample has no value.
    most: u32,
    is_class: bool,
}

impl Layout {
    pub fn of(fields: &[PackedField]) -> Layout {
        let slot = |field: &PackedField| Slot {
            word: field.place as usize / 32,
            shift: field.place % 32,
            mask: (1 << field.scale().bits()) - 1,
            most: field.most,
            is_class: field.is_class(),
        };
        Layout(fields.iter().map(slot).collect())
    }

    /// Whether there are no fields.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The values at a share of the way between two vertices of a line: see [`Field::between`].
    pub(in crate::bake) fn between(&self, [a, b]: [Values; 2], share: f32) -> Values {
        let mut words = Values::default();
        for slot in &self.0 {
            let [from, to] = [a, b].map(|words| words[slot.word] >> slot.shift & slot.mask);
            let code = if slot.is_class || from.max(to) > slot.most {
                if share < 0.5 { from } else { to }
            } else {
                let (from, to) = (f64::from(from), f64::from(to));
                (from + (to - from) * f64::from(share)).round() as u32
            };
            words[slot.word] |= (code & slot.mask) << slot.shift;
        }
        words
    }

    /// The values of a node: the mean of what is below it, by area, and of classes the one with the largest area.
    pub(in crate::bake) fn above(
        &self,
        children: impl Iterator<Item = (Values, f32)> + Clone,
    ) -> Values {
        let mut words = Values::default();
        for slot in &self.0 {
            let code = |words: Values| words[slot.word] >> slot.shift & slot.mask;
            let known = children.clone().map(|(words, weight)| (code(words), f64::from(weight)));
            let known = known.filter(|&(code, _)| code <= slot.most);
            let total: f64 = known.clone().map(|(_, weight)| weight).sum();
            let area = |of: u32| -> f64 {
                known.clone().filter(|&(code, _)| code == of).map(|(_, weight)| weight).sum()
            };
            let mean = match (total > 0.0, slot.is_class) {
                // Without a value, as its children are.
                (false, _) => children.clone().next().map_or(0, |(words, _)| code(words)),
                (true, false) => {
                    let sum: f64 =
                        known.clone().map(|(code, weight)| f64::from(code) * weight).sum();
                    (sum / total).round() as u32
                }
                (true, true) => {
                    let codes = known.clone().map(|(code, _)| code);
                    codes.max_by(|&a, &b| area(a).total_cmp(&area(b)).then(b.cmp(&a))).unwrap_or(0)
                }
            };
            words[slot.word] |= (mean & slot.mask) << slot.shift;
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_come_back_from_their_words() {
        let numbers = [vec![3, 65535, 700], vec![2, 6, 2], vec![0, 65535, 1]];
        let names = ["words", CLASSIFICATION, "wide"];
        let fields = Fields::of_numbers(names.into_iter().zip(numbers.clone()).collect());
        let packed = pack_fields(&fields);
        assert_eq!(value_words(&packed), 2);
        for (field, numbers) in packed.iter().zip(&numbers) {
            for (point, &number) in numbers.iter().enumerate() {
                assert_eq!(field.value(fields.at(point)), Some(f64::from(number)));
            }
        }
        assert_eq!(packed[1].classes().collect::<Vec<_>>(), [2, 6]);
        assert_eq!((packed[0].shown(), packed[0].name()), ([3.0, 65535.0], "words"));
        assert_eq!(value_words(&[]), 0);
    }

    #[test]
    fn nodes_have_the_mean_value_and_the_largest_class() {
        let numbers = vec![("value", vec![10, 20, 100]), (CLASSIFICATION, vec![9, 5, 5])];
        let fields = Fields::of_numbers(numbers);
        let packed = pack_fields(&fields);
        let child = |point: usize| [fields.at(point)[0], 0];
        let children = [(child(0), 2.0), (child(1), 1.0), (child(2), 1.5)];
        let above = Layout::of(&packed).above(children.into_iter());
        let mean: f64 = (2.0 * 10.0 + 20.0 + 150.0) / 4.5;
        assert_eq!(packed[0].value(&above), Some(mean.round()));
        assert_eq!(packed[1].value(&above), Some(5.0));
    }

    #[test]
    fn between_vertices_numbers_change_evenly_and_classes_in_the_middle() {
        let fields =
            Fields::of_numbers(vec![("value", vec![10, 90]), (CLASSIFICATION, vec![9, 5])]);
        let packed = pack_fields(&fields);
        let ends = [0, 1].map(|vertex| values_at(&fields, vertex));
        for (share, number, class) in [(0.25, 30.0, 9.0), (0.5, 50.0, 5.0), (0.75, 70.0, 5.0)] {
            let between = Layout::of(&packed).between(ends, share);
            assert_eq!(packed[0].value(&between), Some(number));
            assert_eq!(packed[1].value(&between), Some(class));
        }
    }
}
