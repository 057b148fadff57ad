use proptest::prelude::*;

use super::*;
use crate::encode::{FrameImage, encode as encode_image};
use crate::film::manifest::checksum;

const SIDES: (u32, u32) = (96, 64);

fn reel(frames: u64) -> Reel {
    let (width, height) = SIDES;
    let (output, format) = (Output::Color, ImageFormat::Png);
    Reel { width, height, fps: 24.0, output, format, frames, bitrate_kbps: None }
}

/// A smooth pattern that moves, and a bar that jumps.
fn picture(frame: u64) -> Vec<[u8; 4]> {
    let (width, height) = SIDES;
    let at = |i: u32| {
        let (x, y) = (f64::from(i % width), f64::from(i / width));
        let wave = |phase: f64| {
            (127.0 + 120.0 * (x / 15.0 + y / 23.0 + phase + frame as f64 / 9.0).sin()) as u8
        };
        let is_bar = (i % width) / 8 == (frame % 12) as u32;
        if is_bar { [250, 250, 240, 255] } else { [wave(0.0), wave(2.0), wave(4.0), 255] }
    };
    (0..width * height).map(at).collect()
}

/// A folder of frames, and their records.
fn folder(frames: u64, format: ImageFormat) -> (tempfile::TempDir, Vec<Record>) {
    folder_of(format, frames, picture)
}

fn folder_of(
    format: ImageFormat,
    frames: u64,
    picture: impl Fn(u64) -> Vec<[u8; 4]>,
) -> (tempfile::TempDir, Vec<Record>) {
    let at = tempfile::tempdir().unwrap();
    let (width, height) = SIDES;
    let records = (0..frames).map(|frame| {
        let image = FrameImage::Color { width, height, rgba: picture(frame) };
        let bytes = encode_image(&image, format, 90).unwrap().bytes;
        let file = crate::film::shots::file_name(frame, format);
        fs::write(at.path().join(&file), &bytes).unwrap();
        let (sha256, bytes) = (checksum(&bytes), bytes.len() as u64);
        Record { frame, t: frame as f64 / 24.0, file, bytes, sha256, tag: String::new() }
    });
    let records = records.collect();
    (at, records)
}

fn go_on() -> AtomicBool {
    AtomicBool::new(false)
}

#[test]
fn what_no_video_can_have_is_refused_before() {
    let coder = Coder::Ffmpeg(PathBuf::from("ffmpeg"));
    let refused = |reel: Reel| match reel.check(&coder) {
        Err(VideoError::Unfit { parameter, reason }) => Some((parameter, reason)),
        Ok(()) => None,
        Err(other) => panic!("{other}"),
    };
    assert_eq!(refused(reel(2)), None);
    let (parameter, reason) = refused(Reel { width: 641, ..reel(2) }).unwrap();
    assert_eq!((parameter, reason.contains("640 or 642")), ("w", true), "{reason}");
    for (other, expected) in [
        (Reel { height: 481, ..reel(2) }, "h"),
        (Reel { height: 8, ..reel(2) }, "h"),
        (Reel { output: Output::Depth, ..reel(2) }, "output"),
        (Reel { format: ImageFormat::Exr, ..reel(2) }, "format"),
        (reel(1), "to"),
        (Reel { bitrate_kbps: Some(3), ..reel(2) }, "bitrate_kbps"),
    ] {
        assert_eq!(refused(other).map(|found| found.0), Some(expected));
    }
    #[cfg(feature = "video")]
    {
        let large = Reel { width: 4096, height: 1000, ..reel(2) };
        assert!(matches!(
            large.check(&Coder::BuiltIn),
            Err(VideoError::Unfit { parameter: "w", .. })
        ));
        let large = Reel { width: 2200, height: 2200, ..reel(2) };
        assert!(matches!(
            large.check(&Coder::BuiltIn),
            Err(VideoError::Unfit { parameter: "h", .. })
        ));
        let large = Reel { width: 2160, height: 3840, ..reel(2) };
        assert!(large.check(&Coder::BuiltIn).is_ok());
    }
}

#[cfg(feature = "video")]
mod built_in {
    use openh264::decoder::Decoder;
    use openh264::formats::YUVSource;

    use super::super::mp4::Summary;
    use super::*;
    use crate::scene::random::SplitMix64;

    /// Decodes the pictures of a file to RGB.
    fn decoded(file: &Path) -> Vec<Vec<u8>> {
        let summary = Summary::read(file).unwrap().unwrap();
        let bytes = fs::read(file).unwrap();
        let mut decoder = Decoder::new().unwrap();
        let mut at = summary.first_at as usize;
        let mut pictures = Vec::new();
        for &size in &summary.sizes {
            // Replace the lengths in front of the units by start codes.
            let (end, mut stream) = (at + size as usize, Vec::new());
            while at < end {
                let length = u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
                stream.extend([0, 0, 0, 1]);
                stream.extend(&bytes[at + 4..at + 4 + length]);
                at += 4 + length;
            }
            let picture = decoder.decode(&stream).unwrap().expect("a picture for each sample");
            let (width, height) = picture.dimensions();
            let mut rgb = vec![0; width * height * 3];
            picture.write_rgb8(&mut rgb);
            pictures.push(rgb);
        }
        pictures
    }

    /// The pattern with noise.
    fn rough(frame: u64, random: &mut SplitMix64) -> Vec<[u8; 4]> {
        let mut noisy = |value: u8| value / 2 + (random.next_u64() % 96) as u8;
        picture(frame).into_iter().map(|[r, g, b, a]| [noisy(r), noisy(g), noisy(b), a]).collect()
    }

    fn psnr_db(rgba: &[[u8; 4]], rgb: &[u8]) -> f64 {
        let source = rgba.iter().flat_map(|pixel| &pixel[..3]);
        let squares: f64 =
            source.zip(rgb).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum();
        10.0 * (255.0f64.powi(2) * rgb.len() as f64 / squares.max(1e-9)).log10()
    }

    #[test]
    fn what_goes_in_comes_out() {
        const FRAMES: u64 = 60;
        for (format, fps, kbps) in [
            (ImageFormat::Png, 24.0, None),
            (ImageFormat::Qoi, 29.97, Some(2000)),
            (ImageFormat::Raw, 120.0, Some(8000)),
        ] {
            let (at, records) = folder(FRAMES, format);
            let out = at.path().join("film.mp4");
            let reel = Reel { format, fps, bitrate_kbps: kbps.or(Some(1500)), ..reel(FRAMES) };
            let mut told = 0;
            encode(&Coder::BuiltIn, &reel, at.path(), &records, &out, &go_on(), |coded| {
                told = coded
            })
            .unwrap();
            assert_eq!(told, FRAMES);
            assert!(!part_of(&out).exists());
            let summary = Summary::read(&out).unwrap().unwrap();
            assert_eq!((summary.frames, (summary.width, summary.height)), (FRAMES, SIDES));
            assert_eq!(summary.timed, (summary.duration, FRAMES));
            let expected_s = FRAMES as f64 / fps;
            assert!((summary.duration_s() - expected_s).abs() < 1e-3, "{} s", summary.duration_s());
            let pictures = decoded(&out);
            assert_eq!(pictures.len() as u64, FRAMES);
            let qualities: Vec<f64> =
                (0..).zip(&pictures).map(|(frame, rgb)| psnr_db(&picture(frame), rgb)).collect();
            let (least, mean) = (
                qualities.iter().fold(f64::INFINITY, |a, &b| a.min(b)),
                qualities.iter().sum::<f64>() / FRAMES as f64,
            );
            // Chroma at half the resolution costs accuracy at the bar's edges, whatever the bitrate.
            assert!(
                least > 24.0 && mean > 27.0,
                "{format:?}: least {least:.1} dB, mean {mean:.1} dB"
            );
            // Each picture is much closer to its own frame than to the previous one.
            for frame in 1..FRAMES {
                let (own, before) = (
                    psnr_db(&picture(frame), &pictures[frame as usize]),
                    psnr_db(&picture(frame - 1), &pictures[frame as usize]),
                );
                assert!(
                    own > before + 3.0,
                    "frame {frame}: {own:.1} dB, {before:.1} dB to the one before"
                );
            }
        }
    }

    #[test]
    fn more_bits_are_a_better_picture() {
        // Noise, which no coder can predict.
        let mut random = SplitMix64::new(5);
        let noise: Vec<Vec<[u8; 4]>> = (0..48).map(|frame| rough(frame, &mut random)).collect();
        let (at, records) = folder_of(ImageFormat::Png, 48, |frame| noise[frame as usize].clone());
        let quality = |kbps: u32| {
            let out = at.path().join(format!("{kbps}.mp4"));
            let reel = Reel { bitrate_kbps: Some(kbps), ..reel(48) };
            encode(&Coder::BuiltIn, &reel, at.path(), &records, &out, &go_on(), |_| ()).unwrap();
            let sum: f64 =
                noise.iter().zip(decoded(&out)).map(|(frame, rgb)| psnr_db(frame, &rgb)).sum();
            (fs::metadata(&out).unwrap().len(), sum)
        };
        let (few, many) = (quality(100), quality(600));
        assert!(few.0 * 2 < many.0 && few.1 < many.1, "{few:?} {many:?}");
        // The video lasts two seconds.
        assert!((75_000..225_000).contains(&many.0), "{many:?}");
    }

    #[test]
    fn whatever_fails_leaves_no_half_video() {
        let (at, records) = folder(6, ImageFormat::Png);
        let out = at.path().join("film.mp4");
        fs::write(&out, "the one before").unwrap();
        let run = |records: &[Record], stop: bool| {
            encode(
                &Coder::BuiltIn,
                &reel(6),
                at.path(),
                records,
                &out,
                &AtomicBool::new(stop),
                |_| (),
            )
        };
        assert!(matches!(run(&records, true), Err(VideoError::Stopped)));
        assert!(matches!(run(&records[..5], false), Err(VideoError::Miscounted { frames: 6, .. })));
        let file = at.path().join(&records[3].file);
        let whole = fs::read(&file).unwrap();
        fs::write(&file, &whole[..whole.len() - 1]).unwrap();
        let refused = run(&records, false).unwrap_err().to_string();
        assert!(
            refused.contains(&records[3].file) && refused.contains("draw the frames again"),
            "{refused}"
        );
        fs::remove_file(&file).unwrap();
        assert!(matches!(run(&records, false), Err(VideoError::Frame { .. })));
        assert_eq!(fs::read_to_string(&out).unwrap(), "the one before");
        assert!(!part_of(&out).exists());
        fs::write(&file, whole).unwrap();
        run(&records, false).unwrap();
        assert_eq!(Summary::read(&out).unwrap().unwrap().frames, 6);
    }
}

/// A script in place of `ffmpeg`.
#[cfg(unix)]
fn program(folder: &Path, script: &str) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let file = folder.join("ffmpeg");
    fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    file
}

#[cfg(unix)]
#[test]
fn the_process_is_fed_every_pixel_and_its_complaints_are_told() {
    let (at, records) = folder(5, ImageFormat::Webp);
    let reel = Reel { format: ImageFormat::Webp, ..reel(5) };
    let out = at.path().join("film.mp4");
    let run = |script: &str| {
        let coder = Coder::Ffmpeg(program(at.path(), script));
        encode(&coder, &reel, at.path(), &records, &out, &go_on(), |_| ())
    };
    // A script that keeps its input and its arguments, and makes no video.
    let fed = at.path().join("fed");
    let called = at.path().join("called");
    let script = format!(
        "cat > {}; for last; do :; done; echo \"$@\" > {}; echo > \"$last\"",
        fed.display(),
        called.display()
    );
    assert!(matches!(run(&script), Err(VideoError::Miscounted { .. })));
    let expected: Vec<u8> = (0..5).flat_map(picture).flat_map(|[r, g, b, _]| [r, g, b]).collect();
    assert!(fs::read(&fed).unwrap() == expected);
    let called = fs::read_to_string(&called).unwrap();
    for words in
        ["-video_size 96x64", "-framerate 24 ", "-pix_fmt rgb24", "libx264", "film.mp4.part"]
    {
        assert!(called.contains(words), "{called}");
    }
    // Scripts that fail at once or at the end, with a message.
    for script in [
        "echo 'Unknown encoder libx264' >&2; exit 8",
        "cat > /dev/null; echo 'Unknown encoder libx264' >&2; exit 8",
    ] {
        let refused = run(script).unwrap_err().to_string();
        assert!(refused.contains("Unknown encoder libx264") && refused.contains('8'), "{refused}");
    }
    // A script that writes more messages than a pipe holds.
    let refused = run(
        "i=0; while [ $i -lt 3000 ]; do echo 'complaint, complaint, complaint, complaint' >&2; i=$((i+1)); done; exit 1",
    );
    assert!(refused.unwrap_err().to_string().len() < 3000);
    assert!(!part_of(&out).exists() && !out.exists());
    let nowhere = Coder::Ffmpeg(at.path().join("none"));
    let refused = encode(&nowhere, &reel, at.path(), &records, &out, &go_on(), |_| ());
    assert!(matches!(refused, Err(VideoError::Io { .. })));
}

#[cfg(unix)]
#[test]
fn an_unfinished_file_of_a_killed_process_gets_no_second_writer() {
    let (at, records) = folder(5, ImageFormat::Png);
    let out = at.path().join("film.mp4");
    // Stands for the open file of a program that outlived its server.
    let open = at.path().join("open");
    fs::write(part_of(&out), "the first writer's").unwrap();
    fs::hard_link(part_of(&out), &open).unwrap();
    let script = "cat > /dev/null; for last; do :; done; echo > \"$last\"";
    let coder = Coder::Ffmpeg(program(at.path(), script));
    let coded = encode(&coder, &reel(5), at.path(), &records, &out, &go_on(), |_| ());
    assert!(matches!(coded, Err(VideoError::Miscounted { .. })), "{coded:?}");
    assert_eq!(fs::read_to_string(open).unwrap(), "the first writer's");
}

/// Programs that read nothing, or read everything and never end.
#[cfg(unix)]
#[test]
fn a_process_that_hangs_is_killed_by_a_stop() {
    use std::time::{Duration, Instant};

    // More pixels than a pipe holds.
    let (at, records) = folder(12, ImageFormat::Png);
    let out = at.path().join("film.mp4");
    let id = at.path().join("id");
    for script in ["exec sleep 600", "cat > /dev/null; exec sleep 600"] {
        let script = format!("echo $$ > {}; {script}", id.display());
        let coder = Coder::Ffmpeg(program(at.path(), &script));
        let (stop, began) = (go_on(), Instant::now());
        let runs = || fs::read_to_string(&id).is_ok_and(|id| id.ends_with('\n'));
        let stopped = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !runs() && began.elapsed() < Duration::from_secs(30) {
                    std::thread::sleep(Duration::from_millis(5));
                }
                std::thread::sleep(Duration::from_millis(200));
                stop.store(true, Ordering::Relaxed);
            });
            encode(&coder, &reel(12), at.path(), &records, &out, &stop, |_| ())
        });
        assert!(matches!(stopped, Err(VideoError::Stopped)), "{stopped:?}");
        assert!(began.elapsed() < Duration::from_secs(60), "{:?}", began.elapsed());
        assert!(!part_of(&out).exists() && !out.exists());
        let number = fs::read_to_string(&id).unwrap();
        let is_there = Path::new("/proc").join(number.trim()).exists();
        assert!(!is_there, "process {number} still runs");
        fs::remove_file(&id).unwrap();
    }
}

/// A clock on which a minute passes between two looks.
#[cfg(unix)]
fn hasty() -> std::time::Instant {
    use std::sync::LazyLock;
    use std::sync::atomic::AtomicU64;
    use std::time::{Duration, Instant};

    static BEGAN: LazyLock<Instant> = LazyLock::new(Instant::now);
    static LOOKS: AtomicU64 = AtomicU64::new(0);
    *BEGAN + Duration::from_secs(60 * LOOKS.fetch_add(1, Ordering::Relaxed))
}

/// Programs that read nothing, or read everything and never end.
#[cfg(unix)]
#[test]
fn a_process_that_makes_no_progress_is_killed() {
    let at = tempfile::tempdir().unwrap();
    let (out, go_on) = (at.path().join("film.mp4"), go_on());
    for script in ["exec sleep 600", "cat > /dev/null; exec sleep 600"] {
        let program = program(at.path(), script);
        let started = ffmpeg::Process::start(&program, &reel(12), &out, &go_on, hasty);
        let mut process = Box::new(started.unwrap());
        let pixels = vec![0; (SIDES.0 * SIDES.1 * 3) as usize];
        let pushed = (0..12).try_for_each(|_| process.push(pixels.clone()));
        let refused = pushed.and_then(|()| process.finish()).unwrap_err().to_string();
        assert!(refused.contains("film.mp4 for 600 seconds"), "{refused}");
    }
}

/// The real program, if it is installed.
#[test]
fn ffmpeg_makes_what_was_asked_for() {
    let Some(program) = ffmpeg::find(std::env::var_os("PATH").as_deref()) else {
        eprintln!("skipped: no ffmpeg on the PATH");
        return;
    };
    let (at, records) = folder(30, ImageFormat::Png);
    let out = at.path().join("film.mp4");
    encode(&Coder::Ffmpeg(program), &reel(30), at.path(), &records, &out, &go_on(), |_| ())
        .unwrap();
    let summary = mp4::Summary::read(&out).unwrap().unwrap();
    assert_eq!((summary.frames, (summary.width, summary.height)), (30, SIDES));
    assert!((summary.duration_s() - 30.0 / 24.0).abs() < 0.05, "{}", summary.duration_s());
}

#[cfg(unix)]
#[test]
fn programs_are_found_on_the_path() {
    let at = tempfile::tempdir().unwrap();
    let none = at.path().join("none");
    fs::create_dir(&none).unwrap();
    fs::write(none.join("ffmpeg"), "not a program").unwrap();
    let there = program(at.path(), "true");
    let path = std::env::join_paths([none.as_path(), at.path()]).unwrap();
    assert_eq!(ffmpeg::find(Some(&path)), Some(there));
    assert_eq!(ffmpeg::find(Some(none.as_os_str())), None);
    assert_eq!(ffmpeg::find(None), None);
}

proptest! {
    #[test]
    fn rates_follow_size_and_stay_in_range(width in 16u32..8192, height in 16u32..8192, fps in 0.001f64..1000.0) {
        let [least, most] = KBPS_RANGE.map(|kbps| kbps * 1000);
        let found = Reel { width, height, fps, ..reel(10) };
        prop_assert!((least..=most).contains(&found.bits_per_second()));
        let asked = Reel { bitrate_kbps: Some(777), ..found };
        prop_assert_eq!(asked.bits_per_second(), 777_000);
        prop_assert!(asked.expected_bytes() as f64 <= 777_000.0 / 8.0 * 10.0 / fps + 1.0);
    }
}
