//! Records that the crate compresses come back byte for byte, and hostile GPS times are errors.

use std::io::{self, Write};

use laz::LazItemRecordBuilder;
use laz::encoders::ArithmeticEncoder;
use laz::las::v2::LasPoint0Compressor;
use laz::las::{Point1, Point3, Point6, Point7, Point8};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::{
    FieldCompressor, LayeredPointRecordCompressor, RecordCompressor,
    SequentialPointRecordCompressor,
};
use proptest::prelude::*;

use super::*;

fn bytes_of(items: &[LazItem]) -> usize {
    items.iter().map(|item| usize::from(item.size())).sum()
}

fn is_layered(items: &[LazItem]) -> bool {
    items[0].item_type() == LazItemType::Point14
}

fn compress(items: &Vec<LazItem>, records: &[u8]) -> Vec<u8> {
    fn all(mut compressor: impl RecordCompressor<Vec<u8>>, records: &[u8]) -> Vec<u8> {
        compressor.compress_many(records).unwrap();
        compressor.done().unwrap();
        compressor.into_inner()
    }
    if is_layered(items) {
        let mut compressor = LayeredPointRecordCompressor::new(Vec::new());
        compressor.set_fields_from(items).unwrap();
        all(compressor, records)
    } else {
        let mut compressor = SequentialPointRecordCompressor::new(Vec::new());
        compressor.set_fields_from(items).unwrap();
        all(compressor, records)
    }
}

fn decompress(items: &[LazItem], bytes: &[u8], points: usize) -> io::Result<Vec<u8>> {
    let mut records = vec![0; points * bytes_of(items)];
    if is_layered(items) {
        let mut decoder = LayeredPointRecordDecompressor::new(Cursor::new(bytes));
        add_layered(&mut decoder, items).unwrap();
        decoder.decompress_many(&mut records)?;
    } else {
        let mut decoder = SequentialPointRecordDecompressor::new(Cursor::new(bytes));
        add_sequential(&mut decoder, items).unwrap();
        decoder.decompress_many(&mut records)?;
    }
    Ok(records)
}

/// Records with times that repeat, step, jump and alternate between five sequences, and with times of
/// any bits or NaN. Any byte of the other fields may change; sometimes x and y jump.
fn records(items: &[LazItem], moves: &[(u8, u64)]) -> Vec<u8> {
    let mut record = vec![0x11; bytes_of(items)];
    let mut time = 1i64 << 61;
    let mut all = Vec::new();
    for &(kind, bits) in moves {
        let small = (bits % 10_000) as i64;
        time = match kind {
            0 => time,
            1 => time + 1000,
            2 => time + 1000 * (bits % 620) as i64 - 20_000,
            3 => time + small - 5000,
            4 => time + (bits as i32 / 2) as i64,
            5 | 6 => (((bits >> 32) as i64 % 5 + 1) << 57) + small,
            7 => (bits >> 2) as i64,
            _ => f64::NAN.to_bits() as i64,
        };
        time = time.max(0);
        let changed = (bits >> 8) as usize % (2 * record.len());
        if let Some(byte) = record.get_mut(changed) {
            *byte ^= (bits >> 24) as u8;
        }
        if bits >> 62 == 0 {
            let jump = bits >> (bits % 32);
            record[..8].copy_from_slice(&jump.to_le_bytes());
        }
        let at = if is_layered(items) { 22 } else { 20 };
        record[at..at + 8].copy_from_slice(&time.to_le_bytes());
        all.extend(&record);
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn records_come_back_byte_for_byte(
        moves in proptest::collection::vec((0u8..9, any::<u64>()), 1..400),
    ) {
        for items in [
            LazItemRecordBuilder::version_2_of::<Point1>(0),
            LazItemRecordBuilder::version_2_of::<Point3>(2),
            LazItemRecordBuilder::version_3_of::<Point6>(0),
            LazItemRecordBuilder::version_3_of::<Point7>(2),
            LazItemRecordBuilder::version_4_of::<Point6>(0),
            LazItemRecordBuilder::version_4_of::<Point8>(2),
        ] {
            let records = records(&items, &moves);
            let packed = compress(&items, &records);
            let found = decompress(&items, &packed, moves.len()).unwrap();
            prop_assert!(found == records, "{items:?}");
        }
    }
}

/// Switches before a time: enough to overflow the stack of a decoder that recurses.
const SWITCHES: u32 = 200_000;

/// Compresses times as switches between sequences.
struct Switches(ArithmeticModel);

impl Switches {
    fn new(symbols: u32) -> Self {
        Self(ArithmeticModelBuilder::new(symbols).with_compression(true).build())
    }
}

impl<W: Write> FieldCompressor<W> for Switches {
    fn size_of_field(&self) -> usize {
        8
    }

    fn compress_first(&mut self, target: &mut W, field: &[u8]) -> io::Result<()> {
        target.write_all(field)
    }

    fn compress_with(&mut self, encoder: &mut ArithmeticEncoder<W>, _: &[u8]) -> io::Result<()> {
        (0..SWITCHES).try_for_each(|_| encoder.encode_symbol(&mut self.0, 4))
    }
}

fn assert_damaged(found: io::Result<Vec<u8>>) {
    let reason = found.unwrap_err().to_string();
    assert_eq!(reason, "is damaged: more than 4 switches before a GPS time");
}

#[test]
fn endless_switches_of_sequential_times_are_damage() {
    let items = LazItemRecordBuilder::version_2_of::<Point1>(0);
    let mut compressor = SequentialPointRecordCompressor::new(Vec::new());
    compressor.add_field_compressor(LasPoint0Compressor::default());
    compressor.add_field_compressor(Switches::new(6));
    compressor.compress_many(&records(&items, &[(1, 0); 2])).unwrap();
    compressor.done().unwrap();
    assert_damaged(decompress(&items, &compressor.into_inner(), 2));
}

#[test]
fn endless_switches_of_a_layer_of_times_are_damage() {
    let mut encoder = ArithmeticEncoder::new(Vec::new());
    Switches::new(5).compress_with(&mut encoder, &[]).unwrap();
    encoder.done().unwrap();
    let layer = encoder.into_inner();
    for items in [
        LazItemRecordBuilder::version_3_of::<Point6>(0),
        LazItemRecordBuilder::version_4_of::<Point6>(0),
    ] {
        let mut packed = compress(&items, &records(&items, &[(1, 0); 2]));
        // The size of the last layer, that of times, stands behind the record, a count and 8 sizes.
        let size_at = 30 + 4 + 8 * 4;
        let size = packed[size_at..].first_chunk().copied().unwrap();
        packed.truncate(packed.len() - u32::from_le_bytes(size) as usize);
        packed[size_at..size_at + 4].copy_from_slice(&(layer.len() as u32).to_le_bytes());
        packed.extend(&layer);
        assert_damaged(decompress(&items, &packed, 2));
    }
}
