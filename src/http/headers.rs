//! The headers that carry a frame's receipt.

use std::fmt::Write;

use axum::http::HeaderValue;

use crate::engine::Receipt;

/// `Server-Timing`: queue, batch (recording, with the numbers of frames that shared it and its passes), each GPU
/// pass by its name, readback, encode, total; milliseconds. Passes that did not run are left out.
pub fn server_timing(receipt: &Receipt) -> Option<HeaderValue> {
    let mut line = String::with_capacity(256);
    entry(&mut line, "queue", receipt.queue_ns);
    entry(&mut line, "batch", receipt.record_ns);
    // Writing to a string cannot fail.
    let _ =
        write!(line, ";desc=\"{} frames, {} drawn together\"", receipt.batch_size, receipt.views);
    for pass in receipt.passes.iter().filter(|pass| pass.ran) {
        if let Some(gpu_ns) = pass.gpu_ns {
            entry(&mut line, pass.name, gpu_ns);
        }
    }
    entry(&mut line, "readback", receipt.readback_ns);
    entry(&mut line, "encode", receipt.encode_ns);
    entry(&mut line, "total", receipt.total_ns);
    HeaderValue::from_str(&line).ok()
}

fn entry(line: &mut String, name: &str, ns: u64) {
    if !line.is_empty() {
        line.push_str(", ");
    }
    let _ = write!(line, "{name};dur={}.{:03}", ns / 1_000_000, ns / 1000 % 1000);
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
    use crate::engine::receipt::PassReceipt;

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
                pass("shadow_map", false, None),
                pass("resolve", true, None),
            ],
            total_ns: 12_000_000,
            ..Receipt::default()
        };
        assert_eq!(
            server_timing(&r).unwrap(),
            "queue;dur=0.020, batch;dur=1.500;desc=\"4 frames, 2 drawn together\", project_points;dur=0.812, \
             readback;dur=0.000, encode;dur=0.000, total;dur=12.000"
        );
    }
}
