//! Point records of LAS formats 0 to 10, from bytes to columns.

use glam::DVec3;

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
}

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
    pub intensity: Vec<u16>,
    pub classes: Vec<u8>,
    pub rgb: Vec<[u16; 3]>,
    pub withheld: u64,
    pub not_finite: u64,
}

impl Columns {
    pub(super) fn reserve(&mut self, points: usize, layout: &Layout) {
        self.positions.reserve_exact(points);
        self.intensity.reserve_exact(points);
        self.classes.reserve_exact(points);
        if layout.rgb_at.is_some() {
            self.rgb.reserve_exact(points);
        }
    }

    /// Makes room for `points` more, or says that there is none.
    pub(super) fn try_reserve(&mut self, points: usize, layout: &Layout) -> Result<(), String> {
        let rgb = if layout.rgb_at.is_some() { points } else { 0 };
        self.positions
            .try_reserve(points)
            .and_then(|()| self.intensity.try_reserve(points))
            .and_then(|()| self.classes.try_reserve(points))
            .and_then(|()| self.rgb.try_reserve(rgb))
            .map_err(|_| "there is not enough memory for its points".to_owned())
    }

    /// Takes whole records; a rest shorter than a record is left.
    pub(super) fn extend(&mut self, bytes: &[u8], layout: &Layout) {
        let word = |record: &[u8], at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
        let int = |record: &[u8], at: usize| {
            let [a, b, c, d] = [record[at], record[at + 1], record[at + 2], record[at + 3]];
            f64::from(i32::from_le_bytes([a, b, c, d]))
        };
        // The header's check of the record length covers every index below.
        for record in bytes.chunks_exact(layout.record_bytes) {
            let (class, is_withheld) = layout.class(record);
            if is_withheld {
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
            self.intensity.push(word(record, 12));
            self.classes.push(class);
            if let Some(at) = layout.rgb_at {
                self.rgb.push([word(record, at), word(record, at + 2), word(record, at + 4)]);
            }
        }
    }

    pub(super) fn append(&mut self, mut other: Self) {
        self.positions.append(&mut other.positions);
        self.intensity.append(&mut other.intensity);
        self.classes.append(&mut other.classes);
        self.rgb.append(&mut other.rgb);
        self.withheld += other.withheld;
        self.not_finite += other.not_finite;
    }
}
