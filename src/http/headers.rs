//! The headers that carry a frame's receipt.

use std::fmt::Write;

use axum::http::HeaderValue;

use crate::engine::Receipt;

/// `Server-Timing` in milliseconds: queue, batch (recording, with the numbers of frames and passes in the batch), each GPU
/// pass by its name, device-wait, readback, encode-wait, encode, total. The entries before the total add up to it, except for time between
/// passes. Passes that did not run and times that the adapter cannot give are left out; their time then counts as readback.
pub fn server_timing(receipt: &Receipt) -> Option<HeaderValue> {
    let mut line = String::with_capacity(512);
    entry(&mut line, "queue", receipt.queue_ns, format_args!("waiting for the GPU"));
    let Receipt { batch_size, views, .. } = receipt;
    let plural = if *batch_size == 1 { "" } else { "s" };
    let batch = format_args!("recording {batch_size} frame{plural}, {views} drawn together");
    entry(&mut line, "batch", receipt.record_ns, batch);
    for pass in receipt.passes.iter().filter(|pass| pass.ran) {
        if let Some(gpu_ns) = pass.gpu_ns {
            let name = pass.name;
            entry(&mut line, name, gpu_ns, format_args!("GPU: {name}"));
        }
    }
    let wait_ns = receipt.device_wait_ns;
    entry(&mut line, "device-wait", wait_ns, format_args!("behind frames submitted before"));
    entry(&mut line, "readback", receipt.readback_ns, format_args!("from the GPU to memory"));
    let wait_ns = receipt.encode_wait_ns;
    entry(&mut line, "encode-wait", wait_ns, format_args!("waiting for an encoder"));
    entry(&mut line, "encode", receipt.encode_ns, format_args!("encoding the image"));
    entry(&mut line, "total", receipt.total_ns, format_args!("all of it"));
    HeaderValue::from_str(&line).ok()
}

/// Appends a metric: a token, a duration, and a quoted description for the browser to show.
fn entry(line: &mut String, name: &str, ns: u64, words: std::fmt::Arguments<'_>) {
    let comma = if line.is_empty() { "" } else { ", " };
    let (ms, us) = (ns / 1_000_000, ns / 1000 % 1000);
    // Writing to a string cannot fail.
    let _ = write!(line, "{comma}{name};dur={ms}.{us:03};desc=\"{words}\"");
}

/// `Pointillist-Warning`: the reason why little or nothing is visible or why a goal is not promised, that translucent surfaces may be missing, and a note
/// where the frame is not final.
pub fn warning(receipt: &Receipt) -> Option<HeaderValue> {
    let provisional = receipt.settings.provisional.as_ref().map(|why| {
        format!("the frame is provisional: {why}; wait=complete waits for the final frame")
    });
    let warnings: Vec<String> = receipt.warnings().into_iter().chain(provisional).collect();
    if warnings.is_empty() { None } else { HeaderValue::from_str(&warnings.join("; ")).ok() }
}

/// `Pointillist-Receipt`: the receipt as one line of JSON.
pub fn receipt(receipt: &Receipt) -> Option<HeaderValue> {
    HeaderValue::from_str(&ascii_json(receipt)?).ok()
}

/// JSON with everything outside ASCII escaped, so that any header or log can carry it.
pub fn ascii_json(value: &impl serde::Serialize) -> Option<String> {
    let json = serde_json::to_string(value).ok()?;
    if json.bytes().all(|byte| (0x20..0x7f).contains(&byte)) {
        return Some(json);
    }
    let mut ascii = String::with_capacity(json.len() + 32);
    for character in json.chars() {
        if (' '..='~').contains(&character) {
            ascii.push(character);
            continue;
        }
        for unit in character.encode_utf16(&mut [0; 2]) {
            let _ = write!(ascii, "\\u{unit:04x}");
        }
    }
    Some(ascii)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::receipt::{PassReceipt, TranslucentOrder, TranslucentReceipt};
    use crate::plan::planner::Goal;

    #[test]
    fn a_goal_that_is_not_promised_is_warned_of() {
        let goal = Goal { most_ms: Some(20.0), least_db: None };
        let planned = Some(goal.unplanned("nothing was measured".to_owned()));
        let frame = Receipt { planned, ..Receipt::default() };
        let told = warning(&frame).unwrap();
        assert_eq!(told, "the goal of 20 ms is not promised: nothing was measured");
        let hidden =
            Receipt { nothing_visible: Some("it is behind the camera".to_owned()), ..frame };
        let told = warning(&hidden).unwrap();
        let expected = "nothing is visible: it is behind the camera; the goal of 20 ms is not promised: nothing was measured";
        assert_eq!(told, expected);
        assert_eq!(warning(&Receipt::default()), None);
    }

    #[test]
    fn receipts_survive_any_name() {
        let mut r =
            Receipt { scene: "plaza \u{1d11e} é \u{7f} \n\"".into(), ..Receipt::default() };
        let value = receipt(&r).unwrap();
        let line = value.to_str().unwrap();
        assert!(line.is_ascii() && !line.contains('\n'));
        let back: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(back["scene"], r.scene);
        r.scene = "plain".into();
        assert!(receipt(&r).unwrap().to_str().unwrap().contains("\"scene\":\"plain\""));
    }

    /// More than a byte's step of light behind the surfaces that are kept is told, less is not.
    #[test]
    fn missing_translucent_surfaces_are_warned_of() {
        let warned = |most_left_out| {
            let order = TranslucentOrder::PixelDepth;
            let (layers, deepest, pixels_of_all_layers) = (8, 8, 5);
            let translucent = Some(TranslucentReceipt {
                order,
                layers,
                deepest,
                pixels_of_all_layers,
                most_left_out,
            });
            let line = warning(&Receipt { translucent, ..Receipt::default() });
            line.map(|line| line.to_str().unwrap().to_owned())
        };
        let told = warned(0.168).unwrap();
        assert!(told.contains("behind their nearest 8") && told.contains("16.8 %"), "{told}");
        assert_eq!([warned(0.0), warned(0.0039)], [None, None]);
        assert!(warned(0.004).is_some());
    }

    #[test]
    fn timing_lists_what_ran() {
        let pass = |name, ran, gpu_ns| PassReceipt { name, ran, gpu_ns, why: None };
        let r = Receipt {
            batch_size: 4,
            views: 2,
            queue_ns: 20_111,
            record_ns: 1_500_000,
            passes: vec![
                pass("project_points", true, Some(812_345)),
                pass("write_output", false, None),
                pass("resolve", true, None),
            ],
            total_ns: 12_000_000,
            ..Receipt::default()
        };
        assert_eq!(
            server_timing(&r).unwrap(),
            "queue;dur=0.020;desc=\"waiting for the GPU\", \
             batch;dur=1.500;desc=\"recording 4 frames, 2 drawn together\", \
             project_points;dur=0.812;desc=\"GPU: project_points\", \
             device-wait;dur=0.000;desc=\"behind frames submitted before\", \
             readback;dur=0.000;desc=\"from the GPU to memory\", \
             encode-wait;dur=0.000;desc=\"waiting for an encoder\", \
             encode;dur=0.000;desc=\"encoding the image\", total;dur=12.000;desc=\"all of it\""
        );
        let alone = server_timing(&Receipt { batch_size: 1, views: 1, ..r }).unwrap();
        assert!(alone.to_str().unwrap().contains("\"recording 1 frame, 1 drawn together\""));
    }
}
