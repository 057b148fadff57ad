//! Scalar fields: numbers that a file gives each point besides position, colour, normal and size.
//!
//! A reader collects a [`Column`] of numbers for each field. [`Spans`] sees all of them, which may take a pass over the file, and
//! then encodes them: a [`Field`] has a code of at most 16 bits for each point. Whole numbers keep their exact values wherever their
//! range allows.

use std::collections::HashSet;

use rayon::prelude::*;

use super::points::quote;

/// Strength of the returned signal.
pub const INTENSITY: &str = "intensity";
/// Class of what was hit: an ASPRS class (LAS 1.4 R15, table 17), or a label.
pub const CLASSIFICATION: &str = "classification";
/// Number of a return among those of its pulse, from 1.
pub const RETURN_NUMBER: &str = "return_number";

/// Maximum number of words that the codes of a point take together.
pub const MOST_WORDS: usize = 2;
/// Maximum number of bytes of a field's name.
pub const MOST_NAME_BYTES: usize = 64;
/// Maximum number of fields that a warning names.
const MOST_NAMED: usize = 8;
/// Larger numbers count as missing.
const LARGEST: f64 = 1e300;

/// Places codes of these widths in the words of a point, the first in the lowest bits of the first word. Returns for each the number
/// of its lowest bit, counted through all words; `None` where no word has room.
pub fn places(bits: impl Iterator<Item = u32>) -> impl Iterator<Item = Option<u32>> {
    let mut used = [0; MOST_WORDS];
    bits.map(move |bits| {
        let word = used.iter().position(|used| used + bits <= u32::BITS)?;
        let place = word as u32 * u32::BITS + used[word];
        used[word] += bits;
        Some(place)
    })
}

/// A scalar field: its name, what its codes mean, and where a point's words have them.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    pub name: String,
    pub scale: Scale,
    /// Lowest bit of the code, counted through the words of a point.
    pub place: u32,
}

impl Field {
    /// The code of a point with these words.
    pub fn code(&self, words: &[u32]) -> u16 {
        let mask = (1 << self.scale.bits()) - 1;
        let word = words.get(self.place as usize / 32).copied().unwrap_or_default();
        (word >> (self.place % 32) & mask) as u16
    }

    /// The value of a point with these words; `None` where it has none.
    pub fn value(&self, words: &[u32]) -> Option<f64> {
        self.scale.value(self.code(words))
    }

    /// The value at a share of the way between two vertices of a line, which changes evenly. Classes change in the middle, and so does a value that
    /// one of the vertices lacks.
    pub fn between(&self, [a, b]: [&[u32]; 2], share: f64, is_class: bool) -> Option<f64> {
        match (self.value(a), self.value(b)) {
            (Some(a), Some(b)) if !is_class => Some(a + (b - a) * share),
            (a, b) => {
                if share < 0.5 {
                    a
                } else {
                    b
                }
            }
        }
    }
}

/// The scalar fields of a cloud. Each point has a few words, which hold the codes of all fields.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fields {
    list: Vec<Field>,
    /// Words of a point, at most [`MOST_WORDS`].
    width: usize,
    words: Vec<u32>,
}

impl Fields {
    /// Fields whose codes are zero. Those that the words have no room for are left out.
    fn empty(fields: impl Iterator<Item = (String, Scale)> + Clone, points: usize) -> Fields {
        let places = places(fields.clone().map(|(_, scale)| scale.bits()));
        let list = fields.zip(places);
        let list =
            list.filter_map(|((name, scale), place)| Some(Field { name, scale, place: place? }));
        let list: Vec<Field> = list.collect();
        let width = width_of(list.iter().map(|field| field.place));
        Fields { list, width, words: vec![0; width * points] }
    }

    /// Fields of whole numbers, each with a number for every point.
    pub fn of_numbers(fields: Vec<(&str, Vec<u16>)>) -> Fields {
        let column = |(name, numbers): (&str, Vec<u16>)| Column {
            name: name.to_owned(),
            numbers: Numbers::Words(numbers),
            factor: 1.0,
        };
        encoded(fields.into_iter().map(column).collect(), &mut Vec::new())
    }

    /// Fields whose codes are in these words.
    pub fn from_words(list: Vec<Field>, words: Vec<u32>) -> Fields {
        let width = width_of(list.iter().map(|field| field.place));
        Fields { list, width, words }
    }

    pub fn list(&self) -> &[Field] {
        &self.list
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Number of points; 0 without fields.
    pub fn points(&self) -> usize {
        self.words.len().checked_div(self.width).unwrap_or(0)
    }

    /// Words of a point.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The words of all points, one after the other.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// The words of a point.
    pub fn at(&self, point: usize) -> &[u32] {
        &self.words[self.width * point..self.width * (point + 1)]
    }

    /// The fields of some of the points, in this order.
    pub fn picked(&self, points: impl Iterator<Item = usize>) -> Fields {
        let words = points.flat_map(|point| self.at(point)).copied().collect();
        Fields { list: self.list.clone(), width: self.width, words }
    }

    /// Keeps the flagged points.
    pub(super) fn retain(&mut self, kept: &[bool]) {
        let points = kept.iter().enumerate().filter_map(|(point, &kept)| kept.then_some(point));
        if !self.is_empty() {
            *self = self.picked(points);
        }
    }

    /// Writes the codes of a field.
    fn put(&mut self, field: usize, column: Column) {
        let Field { scale, place, .. } = &self.list[field];
        let (word, shift) = (*place as usize / 32, place % 32);
        let width = self.width;
        let code = |raw: f64| u32::from(scale.code(raw * column.factor)) << shift;
        let words = self.words.par_chunks_mut(width << 12);
        match &column.numbers {
            // Few different numbers have few codes.
            Numbers::Bytes(list) => {
                let codes: Vec<u32> = (0..=255u8).map(|raw| code(raw.into())).collect();
                let lists = words.zip(list.par_chunks(1 << 12));
                lists.for_each(|(words, list)| {
                    for (words, &raw) in words.chunks_exact_mut(width).zip(list) {
                        words[word] |= codes[usize::from(raw)];
                    }
                });
            }
            Numbers::Words(list) => {
                let codes: Vec<u32> = (0..=u16::MAX).map(|raw| code(raw.into())).collect();
                let lists = words.zip(list.par_chunks(1 << 12));
                lists.for_each(|(words, list)| {
                    for (words, &raw) in words.chunks_exact_mut(width).zip(list) {
                        words[word] |= codes[usize::from(raw)];
                    }
                });
            }
            numbers => words.enumerate().for_each(|(chunk, words)| {
                for (words, point) in words.chunks_exact_mut(width).zip(chunk << 12..) {
                    words[word] |= code(numbers.get(point));
                }
            }),
        }
    }
}

/// Words of a point whose codes are at these places.
fn width_of(places: impl Iterator<Item = u32>) -> usize {
    places.map(|place| place as usize / 32 + 1).max().unwrap_or(0)
}

/// The values of codes: `least + step · code`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    pub least: f64,
    pub step: f64,
    /// The largest code of a value.
    pub most: u16,
    /// The code `most + 1` means that a point has no value.
    pub has_gaps: bool,
}

impl Scale {
    pub fn value(&self, code: u16) -> Option<f64> {
        (code <= self.most).then(|| self.least + self.step * f64::from(code))
    }

    /// The code of the nearest value.
    pub fn code(&self, value: f64) -> u16 {
        if !is_value(value) {
            return if self.has_gaps { self.most + 1 } else { 0 };
        }
        ((value - self.least) / self.step).round().clamp(0.0, f64::from(self.most)) as u16
    }

    /// Bits of a code, 1 to 16.
    pub fn bits(&self) -> u32 {
        let last = u32::from(self.most) + u32::from(self.has_gaps);
        (u32::BITS - last.leading_zeros()).max(1)
    }
}

fn is_value(number: f64) -> bool {
    number.abs() <= LARGEST
}

/// The range of a field's values.
#[derive(Clone, Copy, Debug)]
struct Span {
    low: f64,
    high: f64,
    is_fraction: bool,
    has_gaps: bool,
    /// Factor of these numbers.
    factor: f64,
}

impl Default for Span {
    fn default() -> Span {
        let (low, high) = (f64::INFINITY, f64::NEG_INFINITY);
        Span { low, high, is_fraction: false, has_gaps: false, factor: 1.0 }
    }
}

impl Span {
    fn add(&mut self, value: f64) {
        if is_value(value) {
            self.low = self.low.min(value);
            self.high = self.high.max(value);
            self.is_fraction |= value.fract() != 0.0;
        } else {
            self.has_gaps = true;
        }
    }

    fn joined(self, other: Span) -> Span {
        Span {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            is_fraction: self.is_fraction || other.is_fraction,
            has_gaps: self.has_gaps || other.has_gaps,
            factor: other.factor,
        }
    }

    /// The finest scale of these values; `None` if there is none, or if all are zero, which is how formats say that a field is not
    /// used.
    fn scale(self) -> Option<Scale> {
        let Span { low, high, is_fraction, has_gaps, factor } = self;
        if low > high || (low == 0.0 && high == 0.0) {
            return None;
        }
        let most = if has_gaps { u16::MAX - 1 } else { u16::MAX };
        let extent = high - low;
        let step = extent / f64::from(most);
        let (step, most) = if extent <= f64::from(most) && !is_fraction {
            (1.0, extent as u16)
        } else if step.is_normal() {
            (step, most)
        } else {
            // The values are equal, or differ by so little that no step between them is a normal number: all have the lowest.
            (1.0, 0)
        };
        Some(Scale { least: low * factor, step: step * factor, most, has_gaps })
    }
}

/// Numbers as they are read, in the type of the file.
#[derive(Clone, Debug)]
pub(super) enum Numbers {
    Bytes(Vec<u8>),
    Words(Vec<u16>),
    Shorts(Vec<i16>),
    Singles(Vec<f32>),
    Doubles(Vec<f64>),
}

macro_rules! with_list {
    ($numbers:expr, $list:ident => $do:expr) => {
        match $numbers {
            Numbers::Bytes($list) => $do,
            Numbers::Words($list) => $do,
            Numbers::Shorts($list) => $do,
            Numbers::Singles($list) => $do,
            Numbers::Doubles($list) => $do,
        }
    };
}

impl Numbers {
    fn len(&self) -> usize {
        with_list!(self, list => list.len())
    }

    fn get(&self, point: usize) -> f64 {
        match self {
            Numbers::Bytes(list) => list[point].into(),
            Numbers::Words(list) => list[point].into(),
            Numbers::Shorts(list) => list[point].into(),
            Numbers::Singles(list) => list[point].into(),
            Numbers::Doubles(list) => list[point],
        }
    }
}

/// The numbers of a field.
#[derive(Clone, Debug)]
pub(super) struct Column {
    pub name: String,
    pub numbers: Numbers,
    /// Factor of the stored numbers.
    pub factor: f64,
}

impl Column {
    /// A column that holds any number.
    pub fn new(name: &str) -> Column {
        Column::of(name, Numbers::Doubles(Vec::new()))
    }

    pub fn of(name: &str, numbers: Numbers) -> Column {
        Column { name: name.to_owned(), numbers, factor: 1.0 }
    }

    pub fn push(&mut self, value: f64) {
        match &mut self.numbers {
            Numbers::Bytes(list) => list.push(value as u8),
            Numbers::Words(list) => list.push(value as u16),
            Numbers::Shorts(list) => list.push(value as i16),
            Numbers::Singles(list) => list.push(value as f32),
            Numbers::Doubles(list) => list.push(value),
        }
    }

    pub fn reserve(&mut self, points: usize) {
        with_list!(&mut self.numbers, list => list.reserve_exact(points));
    }

    pub fn try_reserve(&mut self, points: usize) -> Result<(), std::collections::TryReserveError> {
        with_list!(&mut self.numbers, list => list.try_reserve(points))
    }

    /// Takes the numbers of a column of the same type.
    pub fn append(&mut self, other: &mut Column) {
        match (&mut self.numbers, &mut other.numbers) {
            (Numbers::Bytes(list), Numbers::Bytes(other)) => list.append(other),
            (Numbers::Words(list), Numbers::Words(other)) => list.append(other),
            (Numbers::Shorts(list), Numbers::Shorts(other)) => list.append(other),
            (Numbers::Singles(list), Numbers::Singles(other)) => list.append(other),
            (Numbers::Doubles(list), Numbers::Doubles(other)) => list.append(other),
            (_, other) => (0..other.len()).for_each(|point| self.push(other.get(point))),
        }
    }

    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Keeps the first points.
    pub fn truncate(&mut self, points: usize) {
        with_list!(&mut self.numbers, list => list.truncate(points));
    }

    /// Keeps the flagged points.
    pub fn retain(&mut self, kept: &[bool]) {
        with_list!(&mut self.numbers, list => super::tidy::retain(list, kept));
    }

    /// The range of the stored numbers, which are multiplied with the factor.
    fn span(&self) -> Span {
        let whole = |low: Option<f64>, high: Option<f64>| match (low, high) {
            (Some(low), Some(high)) => Span { low, high, ..Span::default() },
            _ => Span::default(),
        };
        macro_rules! of_whole {
            ($list:expr) => {{
                let (low, high) =
                    ($list.par_iter().copied().min(), $list.par_iter().copied().max());
                whole(low.map(f64::from), high.map(f64::from))
            }};
        }
        let span = match &self.numbers {
            Numbers::Bytes(list) => of_whole!(list),
            Numbers::Words(list) => of_whole!(list),
            Numbers::Shorts(list) => of_whole!(list),
            numbers => {
                let add = |mut span: Span, point: usize| {
                    span.add(numbers.get(point));
                    span
                };
                let points = (0..numbers.len()).into_par_iter().with_min_len(1 << 12);
                points.fold(Span::default, add).reduce(Span::default, Span::joined)
            }
        };
        Span { factor: self.factor, ..span }
    }
}

/// The columns of a file and the ranges of their values, which decide how they are encoded.
#[derive(Clone, Debug, Default)]
pub(super) struct Spans(Vec<(String, Span)>);

impl Spans {
    /// The ranges of whole columns.
    pub fn of(columns: &[Column]) -> Spans {
        let mut spans = Spans::default();
        spans.add(columns);
        spans
    }

    /// Adds the numbers of some points. Columns are the same in each call.
    pub fn add(&mut self, columns: &[Column]) {
        if self.0.is_empty() {
            self.0 = columns.iter().map(|column| (column.name.clone(), Span::default())).collect();
        }
        for ((_, span), column) in self.0.iter_mut().zip(columns) {
            *span = span.joined(column.span());
        }
    }

    /// The scale of each column that is kept: fields that tell something, the first of each name, as long as [`MOST_WORDS`] have room
    /// for them.
    fn scales(&self) -> impl Iterator<Item = Option<Scale>> {
        let mut known = HashSet::new();
        let scales = self.0.iter().map(|(name, span)| {
            let is_new = known.insert(name.as_str());
            span.scale().filter(|_| is_name(name) && is_new)
        });
        let scales: Vec<Option<Scale>> = scales.collect();
        let bits = scales.clone().into_iter().map(|scale| scale.map_or(0, |scale| scale.bits()));
        let places: Vec<Option<u32>> = places(bits).collect();
        scales.into_iter().zip(places).map(|(scale, place)| scale.filter(|_| place.is_some()))
    }

    /// Encodes columns, of the whole file or of a part of it.
    pub fn fields(&self, columns: Vec<Column>) -> Fields {
        let kept = columns.into_iter().zip(self.scales());
        let kept: Vec<(Column, Scale)> =
            kept.filter_map(|(column, scale)| Some((column, scale?))).collect();
        let points = kept.first().map_or(0, |(column, _)| column.len());
        let names = kept.iter().map(|(column, scale)| (column.name.clone(), *scale));
        let mut fields = Fields::empty(names, points);
        for (field, (column, _)) in kept.into_iter().enumerate() {
            fields.put(field, column);
        }
        fields
    }

    /// Names the fields that are not kept.
    pub fn warning(&self) -> Option<String> {
        let lost = self.0.iter().zip(self.scales());
        let lost = lost.filter(|((_, span), scale)| scale.is_none() && span.scale().is_some());
        let names: Vec<String> = lost.map(|((name, _), _)| quote(name)).collect();
        let bits = 32 * MOST_WORDS;
        let reason = format!(
            "a point keeps {bits} bits of fields, with different names of up to {MOST_NAME_BYTES} bytes"
        );
        (!names.is_empty()).then(|| match &names[..] {
            [name] => format!("field {name} is left out: {reason}"),
            names if names.len() <= MOST_NAMED => {
                format!("fields {} are left out: {reason}", names.join(", "))
            }
            names => {
                let (named, more) = names.split_at(MOST_NAMED);
                let named = named.join(", ");
                format!("fields {named} and {} more are left out: {reason}", more.len())
            }
        })
    }
}

/// Encodes whole columns. Fields that are not kept are named in a warning.
pub(super) fn encoded(columns: Vec<Column>, warnings: &mut Vec<String>) -> Fields {
    let spans = Spans::of(&columns);
    warnings.extend(spans.warning());
    spans.fields(columns)
}

fn is_name(name: &str) -> bool {
    (1..=MOST_NAME_BYTES).contains(&name.len()) && !name.chars().any(char::is_control)
}

/// The name of a file's field: without the prefix of CloudCompare, and the usual one where settings know it.
pub(super) fn name_of(own: &str) -> String {
    let own = own.trim();
    let bare = own.strip_prefix("scalar_").unwrap_or(own);
    match bare.to_ascii_lowercase().as_str() {
        "intensity" | "reflectance" => INTENSITY.to_owned(),
        "classification" | "class" | "label" => CLASSIFICATION.to_owned(),
        "return_number" | "returnnumber" | "return number" => RETURN_NUMBER.to_owned(),
        _ => bare.to_owned(),
    }
}

#[cfg(test)]
mod tests;
