//! The built-in coder: openh264 codes the frames, and muxide writes them into a file.
//!
//! The file's tables come first, so that players can begin before the whole file has arrived. For this the coded pictures are
//! held in memory until the end, up to [`MOST_BYTES`].

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use muxide::api::{Muxer, MuxerBuilder, VideoCodec};
use openh264::OpenH264API;
use openh264::Timestamp;
use openh264::encoder::{
    BitRate, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, MatrixCoefficients,
    RateControlMode, VuiConfig,
};
use openh264::formats::{RgbSliceU8, YUVBuffer};

use super::{Reel, Sink, VideoError};

/// Largest number of bytes of coded pictures.
const MOST_BYTES: u64 = 1 << 30;
/// Seconds between key frames, at which a player can begin.
const INTRA_SECONDS: f64 = 2.0;
/// Range of frame rates that the coder's rate control supports. Others are clamped to it.
const KNOWN_FPS: [f64; 2] = [1.0, 60.0];

pub struct Writer {
    file: PathBuf,
    encoder: Encoder,
    muxer: Muxer<BufWriter<File>>,
    yuv: YUVBuffer,
    size: (usize, usize),
    fps: f64,
    frames: u64,
    bytes: u64,
    picture: Vec<u8>,
}

fn coder(error: impl std::fmt::Display) -> VideoError {
    VideoError::Coder(error.to_string())
}

/// Silences the coder's messages on standard error. The first one comes while the coder is set up.
#[allow(unsafe_code, reason = "the safe interface quiets the coder only after its first remark")]
fn hush(encoder: &mut Encoder) {
    /// `ENCODER_OPTION_TRACE_LEVEL` of openh264's `codec_app_def.h`.
    const TRACE_LEVEL: u8 = 25;
    let mut quiet = 0u32;
    // SAFETY: the coder lives as long as the reference to it; for this option, which it takes before it is set up as well, it reads
    // one 32-bit number during the call and keeps no pointer to it.
    unsafe { encoder.raw_api().set_option(TRACE_LEVEL.into(), (&raw mut quiet).cast()) };
}

impl Writer {
    pub fn new(reel: &Reel, file: &Path) -> Result<Writer, VideoError> {
        let [least, most] = KNOWN_FPS;
        let known_fps = reel.fps.clamp(least, most);
        // The bits per frame at the reel's own rate.
        let bits = f64::from(reel.bits_per_second()) / reel.fps * known_fps;
        let every = (reel.fps * INTRA_SECONDS).round().clamp(1.0, 250.0) as u32;
        let config = EncoderConfig::new()
            .bitrate(BitRate::from_bps(bits.min(f64::from(i32::MAX)) as u32))
            .max_frame_rate(FrameRate::from_hz(known_fps as f32))
            // Every frame is kept; the rate is met on average.
            .rate_control_mode(RateControlMode::Bitrate)
            .skip_frames(false)
            .intra_frame_period(IntraFramePeriod::from_num_frames(every))
            // Matches the conversion of `YUVBuffer`: primaries of sRGB, luma and chroma of BT.601.
            .vui(VuiConfig::bt709().matrix_coefficients(MatrixCoefficients::Smpte170M));
        let mut encoder =
            Encoder::with_api_config(OpenH264API::from_source(), config).map_err(coder)?;
        hush(&mut encoder);
        let out =
            File::create(file).map_err(|error| VideoError::Io { file: file.to_owned(), error })?;
        let muxer = MuxerBuilder::new(BufWriter::new(out))
            .video(VideoCodec::H264, reel.width, reel.height, reel.fps)
            .with_fast_start(true)
            .build()
            .map_err(coder)?;
        let size = (reel.width as usize, reel.height as usize);
        Ok(Writer {
            file: file.to_owned(),
            encoder,
            muxer,
            yuv: YUVBuffer::new(size.0, size.1),
            size,
            fps: reel.fps,
            frames: 0,
            bytes: 0,
            picture: Vec::new(),
        })
    }
}

impl Sink for Writer {
    fn push(&mut self, rgb: Vec<u8>) -> Result<(), VideoError> {
        self.yuv.read_rgb8(RgbSliceU8::new(&rgb, self.size));
        let t_s = self.frames as f64 / self.fps;
        // The coder's clock, which only its rate control uses, counts whole milliseconds.
        let at = Timestamp::from_millis((t_s * 1000.0) as u64);
        let coded = self.encoder.encode_at(&self.yuv, at).map_err(coder)?;
        let is_key = matches!(coded.frame_type(), FrameType::IDR | FrameType::I);
        self.picture.clear();
        coded.write_vec(&mut self.picture);
        if self.picture.is_empty() {
            return Err(VideoError::Coder(format!(
                "the coder returned nothing for frame {}",
                self.frames
            )));
        }
        self.bytes += self.picture.len() as u64;
        if self.bytes > MOST_BYTES {
            let reason = format!(
                "the video exceeds {MOST_BYTES} bytes at frame {}; draw fewer frames or lower the bit rate",
                self.frames
            );
            return Err(VideoError::Unfit { parameter: "bitrate_kbps", reason });
        }
        self.muxer.write_video(t_s, &self.picture, is_key).map_err(coder)?;
        self.frames += 1;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), VideoError> {
        let mut this = *self;
        let failed = |error| VideoError::Io { file: this.file.clone(), error };
        match this.muxer.finish_in_place() {
            Ok(()) => {}
            Err(muxide::api::MuxerError::Io(error)) => return Err(failed(error)),
            Err(error) => return Err(coder(error)),
        }
        // Write the rest of the buffer here, where an error can be reported.
        let out =
            this.muxer.into_writer().into_inner().map_err(|error| failed(error.into_error()))?;
        out.sync_all().map_err(failed)
    }
}
