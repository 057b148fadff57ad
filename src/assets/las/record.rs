//! Point records of LAS formats 0 to 10, from bytes to columns.

use std::collections::TryReserveError;

use glam::DVec3;

use super::super::fields::{CLASSIFICATION, Column, INTENSITY, Numbers, RETURN_NUMBER};
use super::extra::ExtraField;
use super::header::Header;

/// Where a record keeps what is wanted.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    record_bytes: usize,
    scale: DVec3,
    offset: DVec3,
    /// Formats 6 to 10: flags have a byte of their own, classes all 8 bits.
    is_extended: bool,
    /// LAS 1.0 knows no flags in the class byte.
    has_flags: bool,
    rgb_at: Option<usize>,
    gps_time_at: Option<usize>,
    extra: Vec<ExtraField>,
}

/// Steps of the scan angle of formats 6 to 10, in degrees.
const ANGLE_STEP_DEG: f64 = 0.006;

impl Layout {
    pub(super) fn of(header: &Header) -> Self {
        Self {
            record_bytes: header.record_bytes,
            scale: header.scale,
            offset: header.offset,
            is_extended: header.format >= 6,
            has_flags: header.version_minor > 0,
            rgb_at: match header.format {
                2 => Some(20),
                3 | 5 => Some(28),
                7 | 8 | 10 => Some(30),
                _ => None,
            },
            gps_time_at: match header.format {
                1 | 3 | 4 | 5 => Some(20),
                6.. => Some(22),
                _ => None,
            },
            extra: header.extra.clone(),
        }
    }

    /// Empty columns of the fields that records have, the most asked for first.
    fn columns(&self) -> Vec<Column> {
        let (bytes, words) = (Numbers::Bytes(Vec::new()), Numbers::Words(Vec::new()));
        let shorts = Numbers::Shorts(Vec::new());
        let mut columns = vec![
            Column::of(INTENSITY, words.clone()),
            Column::of(CLASSIFICATION, bytes.clone()),
            Column::of(RETURN_NUMBER, bytes.clone()),
            Column::of("number_of_returns", bytes.clone()),
            Column { factor: self.angle_step_deg(), ..Column::of("scan_angle", shorts) },
            Column::of("user_data", bytes),
            Column::of("point_source_id", words),
        ];
        columns.extend(self.gps_time_at.map(|_| Column::new("gps_time")));
        columns.extend(self.extra.iter().map(|extra| Column::new(&extra.name)));
        columns
    }

    fn angle_step_deg(&self) -> f64 {
        if self.is_extended { ANGLE_STEP_DEG } else { 1.0 }
    }

    /// Takes the fields of whole records, column by column.
    fn take(&self, records: &[&[u8]], columns: &mut [Column]) {
        let word = |record: &[u8], at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
        let is_extended = self.is_extended;
        let (number, count) = if is_extended { ((0, 15), (4, 15)) } else { ((0, 7), (3, 7)) };
        let part = |record: &[u8], (shift, mask): (u8, u8)| record[14] >> shift & mask;
        let (user, source) = if is_extended { (17, 20) } else { (17, 18) };
        for (at, column) in columns.iter_mut().enumerate() {
            let each = records.iter().copied();
            match (at, &mut column.numbers) {
                (0, Numbers::Words(list)) => list.extend(each.map(|record| word(record, 12))),
                (1, Numbers::Bytes(list)) => list.extend(each.map(|record| self.class(record).0)),
                (2, Numbers::Bytes(list)) => list.extend(each.map(|record| part(record, number))),
                (3, Numbers::Bytes(list)) => list.extend(each.map(|record| part(record, count))),
                (4, Numbers::Shorts(list)) if is_extended => {
                    list.extend(each.map(|record| word(record, 18) as i16));
                }
                (4, Numbers::Shorts(list)) => {
                    list.extend(each.map(|record| i16::from(record[16] as i8)));
                }
                (5, Numbers::Bytes(list)) => list.extend(each.map(|record| record[user])),
                (6, Numbers::Words(list)) => list.extend(each.map(|record| word(record, source))),
                (at, Numbers::Doubles(list)) => {
                    let first_extra = 7 + usize::from(self.gps_time_at.is_some());
                    match (self.extra.get(at.wrapping_sub(first_extra)), self.gps_time_at) {
                        (Some(extra), _) => list.extend(each.map(|record| extra.value(record))),
                        (None, Some(place)) => list.extend(each.map(|record| {
                            let bytes = record[place..].first_chunk().copied();
                            f64::from_le_bytes(bytes.unwrap_or_default())
                        })),
                        (None, None) => {}
                    }
                }
                _ => {}
            }
        }
    }

    /// The class and whether the point is withheld.
    fn class(&self, record: &[u8]) -> (u8, bool) {
        if self.is_extended {
            return (record[16], record[15] & 0x04 != 0);
        }
        (record[15] & 0x1f, self.has_flags && record[15] & 0x80 != 0)
    }
}

/// The points so far, one entry each; `rgb` stays empty in formats without colour.
#[derive(Default)]
pub(super) struct Columns {
    pub positions: Vec<DVec3>,
    pub fields: Vec<Column>,
    pub rgb: Vec<[u16; 3]>,
    pub withheld: u64,
    pub not_finite: u64,
}

impl Columns {
    pub(super) fn reserve(&mut self, points: usize, layout: &Layout) {
        self.begin(layout);
        self.positions.reserve_exact(points);
        self.fields.iter_mut().for_each(|field| field.reserve(points));
        if layout.rgb_at.is_some() {
            self.rgb.reserve_exact(points);
        }
    }

    /// Makes room for `points` more, or says that there is none.
    pub(super) fn try_reserve(&mut self, points: usize, layout: &Layout) -> Result<(), String> {
        self.begin(layout);
        let rgb = if layout.rgb_at.is_some() { points } else { 0 };
        let mut reserve = || -> Result<(), TryReserveError> {
            self.positions.try_reserve(points)?;
            self.fields.iter_mut().try_for_each(|field| field.try_reserve(points))?;
            self.rgb.try_reserve(rgb)
        };
        reserve().map_err(|_| "there is not enough memory for its points".to_owned())
    }

    fn begin(&mut self, layout: &Layout) {
        if self.fields.is_empty() {
            self.fields = layout.columns();
        }
    }

    /// Takes whole records; a rest shorter than a record is left.
    pub(super) fn extend(&mut self, bytes: &[u8], layout: &Layout) {
        let word = |record: &[u8], at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
        let int = |record: &[u8], at: usize| {
            let [a, b, c, d] = [record[at], record[at + 1], record[at + 2], record[at + 3]];
            f64::from(i32::from_le_bytes([a, b, c, d]))
        };
        let mut kept = Vec::with_capacity(bytes.len() / layout.record_bytes);
        // The header's check of the record length covers every index below.
        for record in bytes.chunks_exact(layout.record_bytes) {
            if layout.class(record).1 {
                self.withheld += 1;
                continue;
            }
            let raw = DVec3::new(int(record, 0), int(record, 4), int(record, 8));
            let position = raw * layout.scale + layout.offset;
            if !position.is_finite() {
                self.not_finite += 1;
                continue;
            }
            self.positions.push(position);
            kept.push(record);
            if let Some(at) = layout.rgb_at {
                self.rgb.push([word(record, at), word(record, at + 2), word(record, at + 4)]);
            }
        }
        self.begin(layout);
        layout.take(&kept, &mut self.fields);
    }

    pub(super) fn append(&mut self, mut other: Self) {
        self.positions.append(&mut other.positions);
        let fields = self.fields.iter_mut().zip(&mut other.fields);
        fields.for_each(|(field, other)| field.append(other));
        self.rgb.append(&mut other.rgb);
        self.withheld += other.withheld;
        self.not_finite += other.not_finite;
    }
}
