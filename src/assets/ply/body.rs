//! The body: rows of scalars and lists in any of the three encodings.
//!
//! A [`Wanted`] says which properties are looked at; the rest is stepped over. Rows without lists
//! are read in blocks of many and decoded at fixed offsets, lists item by item.

use std::io::{BufRead, Read};

use super::super::AssetError;
use super::super::input::Origin;
use super::super::tokens::{Lines, number, shown};
use super::header::{Element, Encoding, Kind, Scalar};
use crate::memory::Meter;

/// Bytes that a block of rows takes at most.
const BLOCK_BYTES: usize = 64 << 10;

/// Which properties of an element matter.
pub(super) struct Wanted {
    /// Per property the place of its value in [`Row::values`], if any.
    pub slots: Vec<Option<usize>>,
    /// Length of [`Row::values`].
    pub values: usize,
    /// The list property that goes to [`Row::list`].
    pub list: Option<usize>,
    /// The list property that goes to [`Row::numbers`].
    pub numbers: Option<usize>,
}

impl Wanted {
    pub fn nothing(element: &Element) -> Wanted {
        let slots = vec![None; element.properties.len()];
        Wanted { slots, values: 0, list: None, numbers: None }
    }
}

/// One element's wanted values.
#[derive(Default)]
pub(super) struct Row {
    pub values: Vec<f64>,
    pub list: Vec<i64>,
    pub numbers: Vec<f32>,
}

pub(super) enum Body<'a, R> {
    Ascii(Lines<'a, R>),
    Binary { reader: R, big: bool, origin: &'a Origin },
}

impl<'a, R: BufRead> Body<'a, R> {
    pub fn new(lines: Lines<'a, R>, encoding: Encoding, origin: &'a Origin) -> Self {
        match encoding {
            Encoding::Ascii => Body::Ascii(lines),
            Encoding::Little | Encoding::Big => {
                Body::Binary { reader: lines.into_reader(), big: encoding == Encoding::Big, origin }
            }
        }
    }

    /// Calls `visit` with every element's index and row.
    pub fn each(
        &mut self,
        element: &Element,
        wanted: &Wanted,
        mut visit: impl FnMut(u64, &Row) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        let mut row = Row { values: vec![0.0; wanted.values], ..Row::default() };
        match self {
            Body::Ascii(lines) => {
                let limit = wanted.slots.len();
                for index in 0..element.count {
                    ascii_row(lines, element, wanted, limit, index, &mut row)?;
                    visit(index, &row)?;
                }
                Ok(())
            }
            Body::Binary { reader, big, origin } => match element.fixed_bytes() {
                Some(stride) => {
                    let file = &origin.name;
                    let block = Block { element, wanted, stride, big: *big, file };
                    block.each(reader, &mut row, visit)
                }
                None => {
                    let file = origin.name.as_str();
                    let meter = origin.admission.meter(file);
                    let mut scan = Scan { reader, element, wanted, big: *big, file, meter };
                    for index in 0..element.count {
                        scan.row(index, &mut row)?;
                        visit(index, &row)?;
                    }
                    Ok(())
                }
            },
        }
    }
}

fn place(element: &Element, index: u64, property: usize) -> String {
    let name = element.properties.get(property).map_or("", |property| property.name.as_str());
    format!("{} {index}, property {name}", element.name)
}

fn truncated(file: &str, element: &Element, index: u64, property: usize) -> AssetError {
    let reason = format!("the file ends here, after {index} of {} elements", element.count);
    AssetError::malformed(file, place(element, index, property), reason)
}

fn ascii_row<R: BufRead>(
    lines: &mut Lines<R>,
    element: &Element,
    wanted: &Wanted,
    properties: usize,
    index: u64,
    row: &mut Row,
) -> Result<(), AssetError> {
    let file = lines.file();
    loop {
        if !lines.advance()? {
            return Err(truncated(file, element, index, 0));
        }
        if lines.tokens().next().is_some() {
            break;
        }
    }
    let line_number = lines.number;
    let mut tokens = lines.tokens();
    for property in 0..properties {
        let fail = |reason: String| {
            let place = format!("{} (line {line_number})", place(element, index, property));
            Err(AssetError::malformed(file, place, reason))
        };
        let Some(token) = tokens.next() else {
            return fail("the line ends before this value".to_owned());
        };
        match element.properties[property].kind {
            Kind::Scalar(_) => {
                let Some(slot) = wanted.slots[property] else { continue };
                match number(token) {
                    Some(value) => row.values[slot] = value,
                    None => return fail(format!("{} is not a number", shown(token))),
                }
            }
            Kind::List { .. } => {
                let Some(count) = integer(token).filter(|count| *count >= 0) else {
                    return fail(format!("{} is no list length", shown(token)));
                };
                let keep = wanted.list == Some(property);
                let keep_numbers = wanted.numbers == Some(property);
                if keep {
                    row.list.clear();
                }
                if keep_numbers {
                    row.numbers.clear();
                }
                for item in 0..count {
                    let Some(token) = tokens.next() else {
                        return fail(format!("the line ends after {item} of {count} items"));
                    };
                    if keep {
                        match integer(token) {
                            Some(value) => row.list.push(value),
                            None => return fail(format!("{} is not an integer", shown(token))),
                        }
                    }
                    if keep_numbers {
                        match number(token) {
                            Some(value) => row.numbers.push(value as f32),
                            None => return fail(format!("{} is not a number", shown(token))),
                        }
                    }
                }
                let is_only = wanted.numbers.is_none() && wanted.slots.iter().all(Option::is_none);
                if keep && is_only && property + 1 < properties {
                    // Nothing behind the only wanted list matters.
                    return Ok(());
                }
            }
        }
    }
    Ok(())
}

fn integer(token: &[u8]) -> Option<i64> {
    let value = number(token)?;
    (value.fract() == 0.0 && value.abs() < 9e15).then_some(value as i64)
}

/// Rows of one size.
struct Block<'a> {
    element: &'a Element,
    wanted: &'a Wanted,
    stride: usize,
    big: bool,
    file: &'a str,
}

impl Block<'_> {
    fn each(
        &self,
        reader: &mut impl Read,
        row: &mut Row,
        mut visit: impl FnMut(u64, &Row) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        let mut fields = Vec::new();
        let mut offset = 0;
        for (property, slot) in self.element.properties.iter().zip(&self.wanted.slots) {
            let Kind::Scalar(scalar) = property.kind else { continue };
            if let Some(slot) = slot {
                fields.push((offset, scalar, *slot));
            }
            offset += scalar.bytes();
        }
        let rows = (BLOCK_BYTES / self.stride).max(1) as u64;
        let mut block = vec![0; self.stride * rows.min(self.element.count) as usize];
        let mut index = 0;
        while index < self.element.count {
            let wish = rows.min(self.element.count - index) as usize * self.stride;
            let got = fill(reader, &mut block[..wish])
                .map_err(|source| AssetError::io(self.file, source))?;
            for bytes in block[..got].chunks_exact(self.stride) {
                for (offset, scalar, slot) in &fields {
                    row.values[*slot] = scalar.decode(&bytes[*offset..], self.big);
                }
                visit(index, row)?;
                index += 1;
            }
            if got < wish {
                return Err(truncated(self.file, self.element, index, self.at(got % self.stride)));
            }
        }
        Ok(())
    }

    /// The property that byte `offset` of a row belongs to.
    fn at(&self, offset: usize) -> usize {
        let mut end = 0;
        let holds = |property: &super::header::Property| {
            if let Kind::Scalar(scalar) = property.kind {
                end += scalar.bytes();
            }
            offset < end
        };
        self.element.properties.iter().position(holds).unwrap_or(0)
    }
}

/// Reads until `into` is full or the stream ends.
fn fill(reader: &mut impl Read, into: &mut [u8]) -> std::io::Result<usize> {
    let mut got = 0;
    while got < into.len() {
        match reader.read(&mut into[got..]) {
            Ok(0) => break,
            Ok(count) => got += count,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(got)
}

/// Rows with lists in them.
struct Scan<'a, R> {
    reader: &'a mut R,
    element: &'a Element,
    wanted: &'a Wanted,
    big: bool,
    file: &'a str,
    /// Items of the list that is being read.
    meter: Meter<'a>,
}

impl<R: BufRead> Scan<'_, R> {
    fn row(&mut self, index: u64, row: &mut Row) -> Result<(), AssetError> {
        for (property, slot) in self.wanted.slots.iter().enumerate() {
            match self.element.properties[property].kind {
                Kind::Scalar(scalar) => {
                    let value = self.scalar(scalar, index, property)?;
                    if let Some(slot) = slot {
                        row.values[*slot] = value;
                    }
                }
                Kind::List { count, item } => {
                    let count = self.scalar(count, index, property)?;
                    if count < 0.0 {
                        return Err(AssetError::malformed(
                            self.file,
                            place(self.element, index, property),
                            format!("the list has {count} items"),
                        ));
                    }
                    let count = count as u64;
                    if self.wanted.list == Some(property) {
                        row.list.clear();
                        let keep = |value: f64| row.list.push(value as i64);
                        self.list(count, item, index, property, 8, keep)?;
                    } else if self.wanted.numbers == Some(property) {
                        row.numbers.clear();
                        let keep = |value: f64| row.numbers.push(value as f32);
                        self.list(count, item, index, property, 4, keep)?;
                    } else {
                        self.list(count, item, index, property, 0, |_| {})?;
                    }
                }
            }
        }
        Ok(())
    }

    fn scalar(&mut self, scalar: Scalar, index: u64, property: usize) -> Result<f64, AssetError> {
        let mut bytes = [0; 8];
        self.take(&mut bytes[..scalar.bytes()], index, property)?;
        Ok(scalar.decode(&bytes, self.big))
    }

    fn take(&mut self, into: &mut [u8], index: u64, property: usize) -> Result<(), AssetError> {
        let got = fill(self.reader, into).map_err(|source| AssetError::io(self.file, source))?;
        if got < into.len() {
            return Err(truncated(self.file, self.element, index, property));
        }
        Ok(())
    }

    /// Steps over a list, and gives each item to `keep`, which keeps it in that many bytes.
    fn list(
        &mut self,
        count: u64,
        item: Scalar,
        index: u64,
        property: usize,
        bytes_kept: u64,
        mut keep: impl FnMut(f64),
    ) -> Result<(), AssetError> {
        let mut bytes = [0; 256];
        let most = bytes.len() / item.bytes();
        let mut left = count;
        while left > 0 {
            let items = left.min(most as u64) as usize;
            let block = &mut bytes[..items * item.bytes()];
            self.take(block, index, property)?;
            self.meter.reach(bytes_kept * (count - left))?;
            let values = block.chunks_exact(item.bytes());
            values.map(|bytes| item.decode(bytes, self.big)).for_each(&mut keep);
            left -= items as u64;
        }
        Ok(())
    }
}
