//! Decoder of the item Point14, the first 30 bytes of a record of formats 6 to 10.
//!
//! The method is LASzip's, in the two versions that the `laz` crate has; GPS times have a decoder
//! without recursion ([`super::gps_time`]). Nine layers hold the fields. The first layer tells what
//! changes at each point, its scanner channel, its returns, x and y. The layer of times has a value only
//! where the first layer says so, so both are decoded together. Each scanner channel has models of its
//! own, and begins with the record before its first point. A layer of no bytes leaves its field as it
//! is.

use std::io::{self, Cursor, Read, Seek};

use laz::DecompressionSelection;
use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::LayeredFieldDecompressor;

use super::gps_time::GpsTimes;

const RECORD_BYTES: usize = 30;
/// Layers of the item.
pub(super) const LAYERS: usize = 9;
/// Places of fields in a record.
const INTENSITY: usize = 12;
const RETURNS: usize = 14;
const FLAGS: usize = 15;
const CLASS: usize = 16;
const USER_DATA: usize = 17;
const ANGLE: usize = 18;
const SOURCE: usize = 20;
const TIME: usize = 22;

type Layer = ArithmeticDecoder<Cursor<Vec<u8>>>;
/// A model that is made when it is needed first.
type Lazy = Option<ArithmeticModel>;

/// Decompressor of the item, version 3 or 4.
pub(super) struct Point14 {
    version: u16,
    layer_bytes: [usize; LAYERS],
    layers: Layers,
    /// The scanner channel of the last point.
    channel: usize,
    models: Box<Channel>,
    /// Models of the other channels that points had.
    others: [Option<Box<Channel>>; 4],
}

#[derive(Default)]
struct Layers {
    basis: Option<Layer>,
    heights: Option<Layer>,
    classes: Option<Layer>,
    flags: Option<Layer>,
    intensities: Option<Layer>,
    angles: Option<Layer>,
    user_data: Option<Layer>,
    sources: Option<Layer>,
    times: Option<Layer>,
}

/// The last point of a scanner channel, and the models of the next one.
struct Channel {
    record: [u8; RECORD_BYTES],
    has_new_time: bool,
    intensities: [u16; 8],
    heights: [i32; 8],
    dx_medians: [Median; 12],
    dy_medians: [Median; 12],
    changes: [Lazy; 8],
    channel: Lazy,
    return_counts: [Lazy; 16],
    return_numbers: [Lazy; 16],
    return_of_same_time: Lazy,
    classes: [Lazy; 64],
    flags: [Lazy; 64],
    user_data: [Lazy; 64],
    dx: IntegerDecompressor,
    dy: IntegerDecompressor,
    z: IntegerDecompressor,
    intensity: IntegerDecompressor,
    angle: IntegerDecompressor,
    source: IntegerDecompressor,
    times: GpsTimes,
}

/// Median of about the last five values.
#[derive(Clone, Copy)]
struct Median {
    sorted: [i32; 5],
    replaces_largest: bool,
}

impl Median {
    fn get(&self) -> i32 {
        self.sorted[2]
    }

    fn add(&mut self, value: i32) {
        let middle = self.sorted[2];
        if self.replaces_largest {
            self.sorted[4] = value;
            self.replaces_largest = value < middle;
        } else {
            self.sorted[0] = value;
            self.replaces_largest = value <= middle;
        }
        self.sorted.sort_unstable();
    }
}

impl Point14 {
    pub(super) fn new(version: u16) -> Self {
        Self {
            version,
            layer_bytes: [0; LAYERS],
            layers: Layers::default(),
            channel: 0,
            models: Channel::after([0; RECORD_BYTES]),
            others: [const { None }; 4],
        }
    }

    fn switch(&mut self, channel: usize) {
        let next = self.others[channel].take();
        let next = next.unwrap_or_else(|| Channel::after(self.models.record));
        self.others[self.channel] = Some(std::mem::replace(&mut self.models, next));
        self.channel = channel;
        let flags = &mut self.models.record[FLAGS];
        *flags = *flags & !0x30 | (channel as u8) << 4;
    }
}

impl<R: Read + Seek> LayeredFieldDecompressor<R> for Point14 {
    fn size_of_field(&self) -> usize {
        RECORD_BYTES
    }

    /// Ignores the selection: every field is wanted.
    fn set_selection(&mut self, _: DecompressionSelection) {}

    fn init_first_point(
        &mut self,
        source: &mut R,
        first: &mut [u8],
        context: &mut usize,
    ) -> io::Result<()> {
        let mut record = [0; RECORD_BYTES];
        source.read_exact(&mut record)?;
        first.copy_from_slice(&record);
        self.channel = usize::from(record[FLAGS] >> 4 & 3);
        self.models = Channel::after(record);
        *context = self.channel;
        Ok(())
    }

    fn read_layers_sizes(&mut self, source: &mut R) -> io::Result<()> {
        for bytes in &mut self.layer_bytes {
            let mut size = [0; 4];
            source.read_exact(&mut size)?;
            *bytes = u32::from_le_bytes(size) as usize;
        }
        Ok(())
    }

    fn read_layers(&mut self, source: &mut R) -> io::Result<()> {
        let layers = &mut self.layers;
        let targets: [&mut Option<Layer>; LAYERS] = [
            &mut layers.basis,
            &mut layers.heights,
            &mut layers.classes,
            &mut layers.flags,
            &mut layers.intensities,
            &mut layers.angles,
            &mut layers.user_data,
            &mut layers.sources,
            &mut layers.times,
        ];
        for (&bytes, layer) in self.layer_bytes.iter().zip(targets) {
            if bytes > 0 {
                let mut data = vec![0; bytes];
                source.read_exact(&mut data)?;
                let decoder = layer.insert(ArithmeticDecoder::new(Cursor::new(data)));
                decoder.read_init_bytes()?;
            }
        }
        Ok(())
    }

    fn decompress_field_with(&mut self, record: &mut [u8], context: &mut usize) -> io::Result<()> {
        let basis = self.layers.basis.as_mut().ok_or(io::ErrorKind::UnexpectedEof)?;
        let changes = self.models.changes(basis)?;
        let is_other_channel = changes & 64 != 0;
        if is_other_channel {
            let steps = decode(&mut self.models.channel, 3, basis)?;
            self.switch((self.channel + steps as usize + 1) % 4);
        }
        // Version 3 tells the other items of a channel only where it changes.
        if is_other_channel || self.version == 4 {
            *context = self.channel;
        }
        self.models.advance(changes, &mut self.layers)?;
        record.copy_from_slice(&self.models.record);
        Ok(())
    }
}

impl Channel {
    /// Models of a channel whose points follow this record.
    fn after(record: [u8; RECORD_BYTES]) -> Box<Self> {
        let numbers = |bits: u32, contexts: u32| {
            IntegerDecompressorBuilder::new().bits(bits).contexts(contexts).build_initialized()
        };
        let median = Median { sorted: [0; 5], replaces_largest: true };
        Box::new(Self {
            record,
            has_new_time: false,
            intensities: [u16::from_le_bytes(part(&record, INTENSITY)); 8],
            heights: [i32::from_le_bytes(part(&record, 8)); 8],
            dx_medians: [median; 12],
            dy_medians: [median; 12],
            changes: [const { None }; 8],
            channel: None,
            return_counts: [const { None }; 16],
            return_numbers: [const { None }; 16],
            return_of_same_time: None,
            classes: [const { None }; 64],
            flags: [const { None }; 64],
            user_data: [const { None }; 64],
            dx: numbers(32, 2),
            dy: numbers(32, 22),
            z: numbers(32, 20),
            intensity: numbers(16, 4),
            angle: numbers(16, 2),
            source: numbers(16, 1),
            times: GpsTimes::of_layer(i64::from_le_bytes(part(&record, TIME))),
        })
    }

    fn returns(&self) -> (u8, u8) {
        (self.record[RETURNS] & 15, self.record[RETURNS] >> 4)
    }

    /// Bits that tell what changes at the next point.
    fn changes(&mut self, basis: &mut Layer) -> io::Result<u32> {
        let (number, count) = self.returns();
        let kind = usize::from(number == 1)
            + 2 * usize::from(number >= count)
            + 4 * usize::from(self.has_new_time);
        decode(&mut self.changes[kind], 128, basis)
    }

    /// Goes on to the next point of this channel.
    fn advance(&mut self, changes: u32, layers: &mut Layers) -> io::Result<()> {
        let basis = layers.basis.as_mut().ok_or(io::ErrorKind::UnexpectedEof)?;
        let [has_new_source, has_new_time, has_new_angle] =
            [32, 16, 8].map(|bit| changes & bit != 0);
        self.has_new_time = has_new_time;
        let (number, count) = self.next_returns(changes, basis)?;
        let is_single = u32::from(count == 1);
        let place = usize::from(RETURNS_KINDS[usize::from(count)][usize::from(number)]) << 1
            | usize::from(has_new_time);

        let median = &mut self.dx_medians[place];
        let dx = self.dx.decompress(basis, median.get(), is_single)?;
        median.add(dx);
        let median = &mut self.dy_medians[place];
        let dy_kind = is_single + (self.dx.k() & !1).min(20);
        let dy = self.dy.decompress(basis, median.get(), dy_kind)?;
        median.add(dy);
        let [x, y] = [0, 4].map(|at| i32::from_le_bytes(part(&self.record, at)));
        self.put(0, x.wrapping_add(dx).to_le_bytes());
        self.put(4, y.wrapping_add(dy).to_le_bytes());

        if let Some(layer) = &mut layers.heights {
            let level = usize::from(count.abs_diff(number).min(7));
            let kind = is_single + (((self.dx.k() + self.dy.k()) / 2) & !1).min(18);
            let z = self.z.decompress(layer, self.heights[level], kind)?;
            self.heights[level] = z;
            self.put(8, z.to_le_bytes());
        }
        let is_last = number >= count;
        let return_kind = 2 * u32::from(number == 1) + u32::from(is_last);
        if let Some(layer) = &mut layers.classes {
            let kind = usize::from(self.record[CLASS] & 31) << 1 | usize::from(return_kind == 3);
            self.record[CLASS] = decode(&mut self.classes[kind], 256, layer)? as u8;
        }
        if let Some(layer) = &mut layers.flags {
            let flags = self.record[FLAGS];
            let kind = usize::from(flags >> 2 & 0x30 | flags & 15);
            let symbol = decode(&mut self.flags[kind], 64, layer)? as u8;
            self.record[FLAGS] = (symbol & 0x30) << 2 | flags & 0x30 | symbol & 15;
        }
        if let Some(layer) = &mut layers.intensities {
            let last =
                &mut self.intensities[(return_kind << 1) as usize | usize::from(has_new_time)];
            *last = self.intensity.decompress(layer, i32::from(*last), return_kind)? as u16;
            let bytes = last.to_le_bytes();
            self.put(INTENSITY, bytes);
        }
        if let Some(layer) = layers.angles.as_mut().filter(|_| has_new_angle) {
            let last = i16::from_le_bytes(part(&self.record, ANGLE));
            let kind = u32::from(has_new_time);
            let angle = self.angle.decompress(layer, i32::from(last), kind)? as i16;
            self.put(ANGLE, angle.to_le_bytes());
        }
        if let Some(layer) = &mut layers.user_data {
            let kind = usize::from(self.record[USER_DATA] / 4);
            self.record[USER_DATA] = decode(&mut self.user_data[kind], 256, layer)? as u8;
        }
        if let Some(layer) = layers.sources.as_mut().filter(|_| has_new_source) {
            let last = u16::from_le_bytes(part(&self.record, SOURCE));
            let source = self.source.decompress(layer, i32::from(last), 0)? as u16;
            self.put(SOURCE, source.to_le_bytes());
        }
        if let Some(layer) = layers.times.as_mut().filter(|_| has_new_time) {
            let time = self.times.next(layer)?;
            self.put(TIME, time.to_le_bytes());
        }
        Ok(())
    }

    /// The next point's return number and number of returns.
    fn next_returns(&mut self, changes: u32, basis: &mut Layer) -> io::Result<(u8, u8)> {
        let (last, mut count) = self.returns();
        if changes & 4 != 0 {
            count = decode(&mut self.return_counts[usize::from(count)], 16, basis)? as u8;
        }
        let number = match changes & 3 {
            0 => last,
            1 => (last + 1) % 16,
            2 => (last + 15) % 16,
            _ if self.has_new_time => {
                decode(&mut self.return_numbers[usize::from(last)], 16, basis)? as u8
            }
            _ => (last + 2 + decode(&mut self.return_of_same_time, 13, basis)? as u8) % 16,
        };
        self.record[RETURNS] = count << 4 | number;
        Ok((number, count))
    }

    fn put<const N: usize>(&mut self, at: usize, bytes: [u8; N]) {
        self.record[at..at + N].copy_from_slice(&bytes);
    }
}

/// The bytes of a field.
fn part<const N: usize>(record: &[u8; RECORD_BYTES], at: usize) -> [u8; N] {
    std::array::from_fn(|byte| record[at + byte])
}

fn decode(model: &mut Lazy, symbols: u32, layer: &mut Layer) -> io::Result<u32> {
    layer.decode_symbol(model.get_or_insert_with(|| ArithmeticModelBuilder::new(symbols).build()))
}

/// Six kinds of returns, by number of returns and return number.
const RETURNS_KINDS: [[u8; 16]; 16] = [
    [0, 1, 2, 3, 4, 5, 3, 4, 4, 5, 5, 5, 5, 5, 5, 5],
    [1, 0, 1, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3],
    [2, 1, 2, 4, 4, 4, 4, 4, 4, 4, 4, 3, 3, 3, 3, 3],
    [3, 3, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [3, 3, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5],
];
