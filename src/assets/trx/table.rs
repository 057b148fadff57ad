//! Data of vertices, streamlines and groups.

use std::io::{Read, Seek};

use super::super::fields::{self, Column, Numbers};
use super::super::trk::COLORS;
use super::super::{AssetError, ReadOptions};
use super::Header;
use super::archive::{Archive, whole};
use super::array::{Array, BIT, Kind};
use super::contents::Per;

/// Data in memory, in the numbers of the file.
pub(super) struct Table {
    name: String,
    per: Per,
    columns: usize,
    pub kind: &'static Kind,
    bytes: Vec<u8>,
}

impl Table {
    /// Reads the data of an entry.
    ///
    /// # Errors
    /// The entry is damaged, has another size than the header says, or names streamlines that do not exist, or there is no memory.
    pub fn read<R: Read + Seek>(
        archive: &mut Archive<'_, R>,
        per: Per,
        array: Array,
        header: &Header,
        file: &str,
        options: &ReadOptions,
    ) -> Result<Table, AssetError> {
        let (kind, bytes) = match per {
            Per::Group => {
                options.admission.grow(file, header.streamlines)?;
                (&BIT, members(archive, &array, header.streamlines, file)?)
            }
            Per::Vertex => {
                array.check_rows(file, header.vertices, "vertices")?;
                (array.kind, archive.read(&array.entry)?)
            }
            Per::Streamline => {
                array.check_rows(file, header.streamlines, "streamlines")?;
                (array.kind, archive.read(&array.entry)?)
            }
        };
        Ok(Table { name: array.name, per, columns: array.columns as usize, kind, bytes })
    }

    /// Whether its rows are red, green and blue.
    pub fn is_color(&self) -> bool {
        self.columns == 3 && COLORS.contains(&self.name.to_ascii_lowercase().as_str())
    }

    /// A field for each number of a row.
    pub fn fields(&self) -> impl Iterator<Item = Column> {
        let name = fields::name_of(&self.name);
        (0..self.columns).map(move |at| {
            let numbers = match self.kind.name {
                "bit" | "uint8" => Numbers::Bytes(Vec::new()),
                "uint16" => Numbers::Words(Vec::new()),
                "int16" => Numbers::Shorts(Vec::new()),
                _ => Numbers::Singles(Vec::new()),
            };
            match self.columns {
                1 => Column::of(&name, numbers),
                _ => Column::of(&format!("{name}_{at}"), numbers),
            }
        })
    }

    /// The numbers of a vertex of a streamline.
    pub fn row(&self, vertex: u64, streamline: u64) -> impl Iterator<Item = f32> {
        let row = if self.per == Per::Vertex { vertex } else { streamline } as usize;
        let bytes = self.columns * self.kind.bytes;
        let numbers = self.bytes[row * bytes..(row + 1) * bytes].chunks_exact(self.kind.bytes);
        numbers.map(|number| self.kind.number(number) as f32)
    }
}

/// For each streamline 1 if a group has it, otherwise 0.
fn members<R: Read + Seek>(
    archive: &mut Archive<'_, R>,
    group: &Array,
    streamlines: u64,
    file: &str,
) -> Result<Vec<u8>, AssetError> {
    let (entry, bytes) = (&group.entry, group.kind.bytes);
    if !entry.bytes.is_multiple_of(bytes as u64) {
        let reason = format!("has {} bytes; accepted is a multiple of {bytes}", entry.bytes);
        return Err(AssetError::malformed(file, &*entry.place, reason));
    }
    let mut members = vec![0; streamlines as usize];
    let mut at = 0u64;
    archive.blocks(entry, |block| {
        for number in block.chunks_exact(bytes).map(whole) {
            let Some(member) = members.get_mut(number as usize) else {
                let reason =
                    format!("is streamline {number}, but header.json counts {streamlines}");
                return Err(AssetError::malformed(
                    file,
                    format!("{}, index {at}", entry.place),
                    reason,
                ));
            };
            *member = 1;
            at += 1;
        }
        Ok(())
    })?;
    Ok(members)
}
