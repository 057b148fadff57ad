//! The fuzzer: `pointillist-fuzz TARGET [-OPTION=VALUE]… [FOLDER]… [FILE]…`, with the options of libFuzzer, or `--list`.

#![no_main]

use std::ffi::{CStr, CString, c_char, c_int};
use std::sync::OnceLock;

use libfuzzer_sys as _;
use pointillist::fuzzing::{Target, targets};

/// Names the target for the processes that libFuzzer starts with this program, whose arguments lack it.
const VARIABLE: &str = "POINTILLIST_FUZZ_TARGET";

static TARGET: OnceLock<Target> = OnceLock::new();

/// Takes the target from the arguments, before libFuzzer reads them.
///
/// # Safety
/// libFuzzer calls this once, from its main function, with the count and the list of arguments.
#[unsafe(export_name = "LLVMFuzzerInitialize")]
unsafe extern "C" fn initialize(count: *mut c_int, arguments: *mut *mut *mut c_char) -> c_int {
    // SAFETY: see above; the list has `count` strings and lives as long as the process.
    let given = unsafe { std::slice::from_raw_parts(*arguments, *count as usize) };
    // SAFETY: each of them ends with a zero.
    let name = |text: *mut c_char| unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned();
    let first = given.get(1).map(|&text| name(text));
    if first.as_deref() == Some("--list") {
        targets().iter().for_each(|target| println!("{}", target.name));
        std::process::exit(0);
    }
    let inherited = std::env::var(VARIABLE).ok();
    let Some(wanted) = inherited.clone().or(first) else {
        eprintln!("name a target; --list lists them");
        std::process::exit(2);
    };
    let Some(target) = targets().into_iter().find(|target| target.name == wanted) else {
        eprintln!("there is no target `{wanted}`; --list lists them");
        std::process::exit(2);
    };
    let _ = TARGET.set(target);
    if inherited.is_none() {
        // SAFETY: no other thread runs yet.
        unsafe { std::env::set_var(VARIABLE, &wanted) };
        // libFuzzer starts itself again under its first argument, which therefore stays.
        let mut rest: Vec<*mut c_char> = given.to_vec();
        rest.remove(1);
        let length = rest.len() as c_int;
        rest.push(CString::default().into_raw());
        // SAFETY: see above; the new list is never freed.
        unsafe {
            *arguments = rest.leak().as_mut_ptr();
            *count = length;
        }
    }
    0
}

#[unsafe(export_name = "rust_fuzzer_test_input")]
fn run(data: &[u8]) -> i32 {
    if let Some(target) = TARGET.get() {
        target.run(data);
    }
    0
}
