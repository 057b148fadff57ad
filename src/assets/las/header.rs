//! The public header block and the variable length records of a LAS file.

use std::io::{Read, Seek, SeekFrom};

use glam::DVec3;

use super::extra::{self, ExtraField};
use super::{AssetError, io_error, malformed};
use crate::assets::points::unsupported;

/// Header bytes up to LAS 1.2, and with the 64-bit counts of LAS 1.4.
const HEADER_BYTES: u64 = 227;
const HEADER_BYTES_1_4: u64 = 375;
const VLR_HEADER_BYTES: u64 = 54;
/// Header bytes of an extended variable length record, which stands behind the points (LAS 1.4 R15, §2.8).
const EVLR_HEADER_BYTES: u64 = 60;
/// Extended records that are looked at.
const MOST_EXTENDED: u32 = 1000;
const LASZIP_USER_ID: &[u8] = b"laszip encoded";
const LASZIP_RECORD_ID: u16 = 22204;
const SPEC_USER_ID: &[u8] = b"LASF_Spec";
const EXTRA_BYTES_RECORD_ID: u16 = 4;

/// Bytes of a record of point formats 0 to 10, without extra bytes.
const FORMAT_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

/// Contents of the header, checked against the file.
#[derive(Clone, Debug)]
pub(super) struct Header {
    pub version_minor: u8,
    /// Point format, 0 to 10.
    pub format: u8,
    pub is_compressed: bool,
    /// Bytes of a (decompressed) record, extra bytes included.
    pub record_bytes: usize,
    pub points: u64,
    /// Where the point data begin.
    pub points_offset: u64,
    pub file_bytes: u64,
    pub scale: DVec3,
    pub offset: DVec3,
    /// Content of the LASzip variable length record.
    pub laszip: Option<Vec<u8>>,
    /// Fields behind those of the point format.
    pub extra: Vec<ExtraField>,
}

/// Little-endian fields at fixed places.
struct Block([u8; HEADER_BYTES_1_4 as usize]);

impl Block {
    fn bytes<const N: usize>(&self, at: usize) -> [u8; N] {
        self.0.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
    }

    fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.bytes(at))
    }

    fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.bytes(at))
    }

    fn u64(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.bytes(at))
    }

    fn vec3(&self, at: usize) -> DVec3 {
        DVec3::from([0, 8, 16].map(|i| f64::from_le_bytes(self.bytes(at + i))))
    }
}

impl Header {
    /// Reads the header and checks it against the file's length.
    pub(super) fn read<R: Read + Seek>(
        reader: &mut R,
        name: &str,
        warnings: &mut Vec<String>,
    ) -> Result<Self, AssetError> {
        let io = |source| io_error(name, source);
        let bad = |field: &str, reason: String| malformed(name, format!("header, {field}"), reason);
        let file_bytes = reader.seek(SeekFrom::End(0)).map_err(io)?;
        reader.seek(SeekFrom::Start(0)).map_err(io)?;
        let mut block = Block([0; HEADER_BYTES_1_4 as usize]);
        let present = file_bytes.min(HEADER_BYTES_1_4) as usize;
        reader.read_exact(&mut block.0[..present]).map_err(io)?;
        if &block.bytes::<4>(0) != b"LASF" {
            return Err(unsupported(name, "the signature LASF is missing: not a LAS or LAZ file"));
        }
        let header_bytes = u64::from(block.u16(94));
        if file_bytes < HEADER_BYTES || !(HEADER_BYTES..=file_bytes).contains(&header_bytes) {
            let reason = format!("is {header_bytes}; the file has {file_bytes} bytes");
            return Err(bad("header size", reason));
        }
        let [major, version_minor] = block.bytes(24);
        if major != 1 {
            return Err(unsupported(
                name,
                format!("LAS version {major}.{version_minor}; 1.0 to 1.4 are read"),
            ));
        }
        let points_offset = u64::from(block.u32(96));
        if !(header_bytes..=file_bytes).contains(&points_offset) {
            let reason = format!("is {points_offset}; the file has {file_bytes} bytes");
            return Err(bad("offset to point data", reason));
        }
        let [flagged_format] = block.bytes(104);
        let (is_compressed, format) = (flagged_format & 0x80 != 0, flagged_format & 0x7f);
        let Some(&format_bytes) = FORMAT_BYTES.get(usize::from(format)) else {
            return Err(unsupported(name, format!("point format {format}; 0 to 10 are read")));
        };
        let record_bytes = usize::from(block.u16(105));
        if record_bytes < format_bytes {
            let reason = format!("is {record_bytes}; format {format} has {format_bytes} bytes");
            return Err(bad("point data record length", reason));
        }
        let wide = version_minor >= 4 && header_bytes >= HEADER_BYTES_1_4;
        let points = match block.u64(247) {
            count if wide && count > 0 => count,
            _ => u64::from(block.u32(107)),
        };
        if !is_compressed {
            let room = (file_bytes - points_offset) / record_bytes as u64;
            if points > room {
                let reason = format!("is {points}; the file has room for {room}");
                return Err(bad("number of point records", reason));
            }
        }
        let (scale, offset) = (block.vec3(131), block.vec3(155));
        if !scale.is_finite() || scale.cmpeq(DVec3::ZERO).any() {
            return Err(bad("scale factor", format!("is {scale}")));
        }
        if !offset.is_finite() {
            return Err(bad("offset", format!("is {offset}")));
        }
        let declared = block.u32(100);
        let Records { laszip, mut extra } =
            find_records(reader, header_bytes, points_offset, declared, warnings).map_err(io)?;
        if wide && extra.is_empty() && record_bytes > format_bytes {
            let (start, count) = (block.u64(235), block.u32(243));
            extra = extended_declarations(reader, start, file_bytes, count).map_err(io)?;
        }
        let extra = extra::declared(&extra, format_bytes, record_bytes);
        Ok(Self {
            version_minor,
            format,
            is_compressed,
            record_bytes,
            points,
            points_offset,
            file_bytes,
            scale,
            offset,
            laszip,
            extra,
        })
    }
}

/// Contents of the variable length records that are used.
#[derive(Default)]
struct Records {
    laszip: Option<Vec<u8>>,
    /// Declarations of extra bytes.
    extra: Vec<u8>,
}

/// Steps through the variable length records between header and points, however many are declared.
fn find_records<R: Read + Seek>(
    reader: &mut R,
    start: u64,
    end: u64,
    declared: u32,
    warnings: &mut Vec<String>,
) -> std::io::Result<Records> {
    let (mut at, mut found) = (start, Records::default());
    for index in 0..declared {
        let mut head = [0; VLR_HEADER_BYTES as usize];
        let mut length = 0;
        if at + VLR_HEADER_BYTES <= end {
            reader.seek(SeekFrom::Start(at))?;
            reader.read_exact(&mut head)?;
            length = u64::from(u16::from_le_bytes([head[20], head[21]]));
        }
        if at + VLR_HEADER_BYTES + length > end {
            warnings.push(format!(
                "declares {declared} variable length records; {index} fit before the points"
            ));
            break;
        }
        let is = |user: &[u8], id: u16| {
            head[2..18].starts_with(user) && u16::from_le_bytes([head[18], head[19]]) == id
        };
        let (is_laszip, is_extra) =
            (is(LASZIP_USER_ID, LASZIP_RECORD_ID), is(SPEC_USER_ID, EXTRA_BYTES_RECORD_ID));
        if is_laszip || is_extra {
            let mut data = vec![0; length as usize];
            reader.read_exact(&mut data)?;
            if is_laszip {
                found.laszip = Some(data);
            } else {
                found.extra = data;
            }
        }
        at += VLR_HEADER_BYTES + length;
    }
    Ok(found)
}

/// Declarations of extra bytes among the extended variable length records; empty where there are none.
fn extended_declarations<R: Read + Seek>(
    reader: &mut R,
    start: u64,
    end: u64,
    declared: u32,
) -> std::io::Result<Vec<u8>> {
    let fits = |from: u64, bytes: u64| from.checked_add(bytes).filter(|behind| *behind <= end);
    let mut at = start;
    for _ in 0..declared.min(MOST_EXTENDED) {
        let Some(begin) = fits(at, EVLR_HEADER_BYTES) else { break };
        let mut head = [0; EVLR_HEADER_BYTES as usize];
        reader.seek(SeekFrom::Start(at))?;
        reader.read_exact(&mut head)?;
        let mut length = [0; 8];
        length.copy_from_slice(&head[20..28]);
        let length = u64::from_le_bytes(length);
        let Some(behind) = fits(begin, length) else { break };
        let is_extra = head[2..18].starts_with(SPEC_USER_ID)
            && u16::from_le_bytes([head[18], head[19]]) == EXTRA_BYTES_RECORD_ID;
        if is_extra {
            // A record has no more extra bytes than its length can say.
            let mut data = vec![0; length.min(extra::MOST_BYTES) as usize];
            reader.read_exact(&mut data)?;
            return Ok(data);
        }
        at = behind;
    }
    Ok(Vec::new())
}
