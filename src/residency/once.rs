//! A value that is made by whoever needs it first, who may give up and leave it to the next.

use std::sync::OnceLock;
use std::time::Duration;

use parking_lot::Mutex;

/// How often who waits for another's making asks whether it still has to.
const ASK_EVERY: Duration = Duration::from_millis(20);

/// A value that is made once, or not at all yet.
#[derive(Debug)]
pub struct MadeOnce<T> {
    value: OnceLock<T>,
    making: Mutex<()>,
}

impl<T> Default for MadeOnce<T> {
    fn default() -> Self {
        Self { value: OnceLock::new(), making: Mutex::new(()) }
    }
}

impl<T> MadeOnce<T> {
    pub fn get(&self) -> Option<&T> {
        self.value.get()
    }

    /// The value. Where there is none this makes it, or waits for who does, for as long as `is_wanted` has no error.
    ///
    /// # Errors
    /// Those of `is_wanted` and of `make`; there is no value then.
    pub fn get_or_try<E>(
        &self,
        is_wanted: impl Fn() -> Result<(), E>,
        make: impl FnOnce() -> Result<T, E>,
    ) -> Result<&T, E> {
        loop {
            if let Some(value) = self.get() {
                return Ok(value);
            }
            is_wanted()?;
            let Some(_alone) = self.making.try_lock_for(ASK_EVERY) else { continue };
            if let Some(value) = self.get() {
                return Ok(value);
            }
            let made = make()?;
            return Ok(self.value.get_or_init(|| made));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[test]
    fn who_gives_up_leaves_it_to_the_next() {
        let value = MadeOnce::default();
        let wanted = || Ok(());
        assert_eq!(value.get_or_try(wanted, || Err("not now")), Err("not now"));
        assert_eq!(value.get(), None);
        assert_eq!(value.get_or_try(|| Err("unwanted"), || Ok(1)), Err("unwanted"));
        assert_eq!(value.get_or_try(wanted, || Ok(7)), Ok(&7));
        assert_eq!(value.get_or_try(|| Err("unwanted"), || Err("never asked")), Ok(&7));
    }

    #[test]
    fn one_makes_it_and_the_others_wait() {
        let (value, made) = (MadeOnce::default(), AtomicU32::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let make = || {
                        std::thread::sleep(Duration::from_millis(50));
                        Ok::<_, ()>(made.fetch_add(1, Ordering::Relaxed))
                    };
                    assert_eq!(value.get_or_try(|| Ok(()), make), Ok(&0));
                });
            }
        });
        assert_eq!(made.into_inner(), 1);
    }

    #[test]
    fn who_waits_may_go() {
        let value = MadeOnce::<u32>::default();
        let _somebody = value.making.lock();
        let asked = AtomicU32::new(0);
        let is_wanted = || {
            if asked.fetch_add(1, Ordering::Relaxed) < 3 { Ok(()) } else { Err("unwanted") }
        };
        assert_eq!(value.get_or_try(is_wanted, || Ok(1)), Err("unwanted"));
    }
}
