//! Decoder of GPS times: the item GpsTime11 of version 2, and the layer of times of formats 6 to 10.
//!
//! The method is LASzip's. A time is an integer: the bits of its f64. The decoder keeps four sequences,
//! each with its last time and the step between its times. A symbol tells the next time as a multiple
//! of the step, with a corrector behind it. Other symbols begin a sequence, or switch to another one,
//! and then one more symbol follows. The `laz` crate calls itself at each switch, and a switch may cost
//! less than a thousandth of a bit, so that a few bytes overflow its stack and end the process. This
//! decoder counts switches in a loop.

use std::io::{self, Read};

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::FieldDecompressor;

/// Compressors switch at most once before a time.
const MOST_SWITCHES: u32 = 4;
/// Largest multiple of the step that has a symbol.
const MOST_STEPS: i32 = 500;
/// Least multiple of the step that has a symbol.
const LEAST_STEPS: i32 = -10;
/// Symbols of the multiples from [`LEAST_STEPS`] to [`MOST_STEPS`].
const MULTIPLES: u32 = (MOST_STEPS - LEAST_STEPS + 1) as u32;
/// Times that no symbol fits well, after which the step changes.
const MOST_STRAYS: u32 = 3;

#[derive(Clone, Copy, Default)]
struct Sequence {
    time: i64,
    step: i32,
    /// Times since the last change of the step that no symbol fitted well.
    strays: u32,
}

/// Times so far, and the models of those to come.
pub(super) struct GpsTimes {
    sequences: [Sequence; 4],
    current: usize,
    newest: usize,
    /// Symbols for a time that has not changed: 1 in the item, 0 in layers, which skip such times.
    repeats: u32,
    /// Model of symbols while the step is 0.
    without_step: ArithmeticModel,
    with_step: ArithmeticModel,
    correctors: IntegerDecompressor,
}

impl GpsTimes {
    /// Times of a layer, which begin with that of the record before.
    pub(super) fn of_layer(first: i64) -> Self {
        Self::new(first, 0)
    }

    /// Times of the item of version 2.
    pub(super) fn of_item() -> Self {
        Self::new(0, 1)
    }

    fn new(first: i64, repeats: u32) -> Self {
        let mut sequences = [Sequence::default(); 4];
        sequences[0].time = first;
        Self {
            sequences,
            current: 0,
            newest: 0,
            repeats,
            // A repetition, a difference, a new sequence and three switches.
            without_step: ArithmeticModelBuilder::new(repeats + 5).build(),
            with_step: ArithmeticModelBuilder::new(MULTIPLES + repeats + 4).build(),
            correctors: IntegerDecompressorBuilder::new().bits(32).contexts(9).build_initialized(),
        }
    }

    /// The next time, as the bits of an f64.
    pub(super) fn next<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<i64> {
        for _ in 0..=MOST_SWITCHES {
            let sequence = &mut self.sequences[self.current];
            let (model, repeated) = match sequence.step {
                0 => (&mut self.without_step, 0),
                _ => (&mut self.with_step, MULTIPLES),
            };
            // The first symbol behind those of differences begins a sequence, the next ones switch.
            let begins = repeated.max(1) + self.repeats;
            let symbol = decoder.decode_symbol(model)?;
            if symbol > begins {
                self.current = (self.current + (symbol - begins) as usize) % 4;
                continue;
            }
            if symbol == begins {
                let context = (sequence.time >> 32) as i32;
                let high = self.correctors.decompress(decoder, context, 8)?;
                let time = i64::from(high) << 32 | i64::from(decoder.read_int()?);
                self.newest = (self.newest + 1) % 4;
                self.current = self.newest;
                self.sequences[self.current] = Sequence { time, ..Sequence::default() };
                return Ok(time);
            }
            if self.repeats == 0 || symbol != repeated {
                sequence.advance(symbol, &mut self.correctors, decoder)?;
            }
            return Ok(sequence.time);
        }
        let reason = format!("is damaged: more than {MOST_SWITCHES} switches before a GPS time");
        Err(io::Error::new(io::ErrorKind::InvalidData, reason))
    }
}

impl Sequence {
    /// Adds the difference that follows `symbol`.
    fn advance<R: Read>(
        &mut self,
        symbol: u32,
        correctors: &mut IntegerDecompressor,
        decoder: &mut ArithmeticDecoder<R>,
    ) -> io::Result<()> {
        if self.step == 0 {
            self.step = correctors.decompress(decoder, 0, 0)?;
            self.strays = 0;
            self.time = self.time.wrapping_add(i64::from(self.step));
            return Ok(());
        }
        let symbol = symbol as i32;
        let (multiple, context, is_stray) = match symbol {
            0 => (0, 7, true),
            1 => (1, 1, false),
            2..10 => (symbol, 2, false),
            10..MOST_STEPS => (symbol, 3, false),
            MOST_STEPS => (MOST_STEPS, 4, true),
            _ if MOST_STEPS - symbol > LEAST_STEPS => (MOST_STEPS - symbol, 5, false),
            _ => (LEAST_STEPS, 6, true),
        };
        let expected = self.step.wrapping_mul(multiple);
        let difference = correctors.decompress(decoder, expected, context)?;
        if multiple == 1 {
            self.strays = 0;
        }
        if is_stray {
            self.strays += 1;
            if self.strays > MOST_STRAYS {
                (self.step, self.strays) = (difference, 0);
            }
        }
        self.time = self.time.wrapping_add(i64::from(difference));
        Ok(())
    }
}

impl<R: Read> FieldDecompressor<R> for GpsTimes {
    fn size_of_field(&self) -> usize {
        8
    }

    fn decompress_first(&mut self, source: &mut R, first: &mut [u8]) -> io::Result<()> {
        let mut time = [0; 8];
        source.read_exact(&mut time)?;
        first.copy_from_slice(&time);
        self.sequences[0].time = i64::from_le_bytes(time);
        Ok(())
    }

    fn decompress_with(
        &mut self,
        decoder: &mut ArithmeticDecoder<R>,
        field: &mut [u8],
    ) -> io::Result<()> {
        field.copy_from_slice(&self.next(decoder)?.to_le_bytes());
        Ok(())
    }
}
