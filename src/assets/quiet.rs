//! Panics of foreign decoders, caught without the report that the runtime prints for each: damage in a file is told to
//! whoever reads it, not to the log.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    static IS_QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Ends the silence, also when it unwinds.
struct Silence {
    before: bool,
}

impl Silence {
    fn begin() -> Self {
        static HOOK: Once = Once::new();
        HOOK.call_once(|| {
            let report = panic::take_hook();
            panic::set_hook(Box::new(move |info| {
                if !IS_QUIET.try_with(Cell::get).unwrap_or(false) {
                    report(info);
                }
            }));
        });
        Self { before: IS_QUIET.replace(true) }
    }
}

impl Drop for Silence {
    fn drop(&mut self) {
        IS_QUIET.set(self.before);
    }
}

/// Runs `decode` on this thread; `None` when it panics. What it has changed is not to be used then.
pub fn catch<T>(decode: impl FnOnce() -> T) -> Option<T> {
    let _silence = Silence::begin();
    panic::catch_unwind(AssertUnwindSafe(decode)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Run by the test below in a process of its own, whose standard error it reads.
    #[test]
    #[ignore = "run by `only_caught_panics_are_silent`"]
    fn panics_of_both_kinds() {
        assert!(catch(|| catch(|| -> u8 { panic!("hush within") })).is_some_and(|r| r.is_none()));
        assert!(catch(|| -> u8 { panic!("hush") }).is_none());
        assert!(panic::catch_unwind(|| panic!("aloud")).is_err());
        assert_eq!(catch(|| 7), Some(7));
    }

    #[test]
    fn only_caught_panics_are_silent() {
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .args([
                "--ignored",
                "--exact",
                "--nocapture",
                "assets::quiet::tests::panics_of_both_kinds",
            ])
            .output()
            .unwrap();
        let words = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words}");
        assert!(String::from_utf8_lossy(&output.stdout).contains("1 passed"));
        assert!(words.contains("aloud") && !words.contains("hush"), "{words}");
    }
}
