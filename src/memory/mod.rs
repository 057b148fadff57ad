//! The host-memory budget: limits what loading, baking and JSON may allocate, before they allocate it (floor 0).
//!
//! [`HostMemory`] is one budget for the whole process. A [`Reservation`] holds some of its bytes and gives them back when
//! it is dropped. An [`Admission`] is one load's share of the budget: it grows step by step as the load learns what it needs,
//! and every step also asks whether the load has been cancelled.
//!
//! The figures are estimates of what the code is about to allocate. They are kept by hand because no allocator can refuse
//! an allocation without ending the process.

mod machine;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use parking_lot::Mutex;

pub use machine::{default_budget, release_unused, resident_bytes, set_up_allocator};

/// A budget of host memory. Clones share it.
#[derive(Clone, Debug)]
pub struct HostMemory(Arc<Ledger>);

#[derive(Debug)]
struct Ledger {
    budget: u64,
    in_use: AtomicU64,
}

/// Reserved bytes of a budget, released when this is dropped.
#[derive(Debug)]
pub struct Reservation {
    memory: HostMemory,
    bytes: u64,
}

/// A reservation that was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{what} needs {needed} bytes of host memory; {in_use} of the budget of {budget} bytes are in use"
)]
pub struct OutOfMemory {
    pub what: String,
    /// Bytes that the holder would have in total, including those that it has already.
    pub needed: u64,
    /// Bytes that other holders have.
    pub in_use: u64,
    pub budget: u64,
}

impl OutOfMemory {
    /// Whether the bytes would be refused even if nothing else were in use.
    pub fn is_hopeless(&self) -> bool {
        self.needed > self.budget
    }
}

/// Why a load cannot go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Interrupt {
    #[error("the load was cancelled")]
    Cancelled,
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
}

impl HostMemory {
    pub fn new(budget: u64) -> HostMemory {
        HostMemory(Arc::new(Ledger { budget, in_use: AtomicU64::new(0) }))
    }

    /// A budget that grants everything.
    pub fn unlimited() -> HostMemory {
        HostMemory::new(u64::MAX)
    }

    pub fn budget(&self) -> u64 {
        self.0.budget
    }

    pub fn in_use(&self) -> u64 {
        self.0.in_use.load(Ordering::Relaxed)
    }

    /// Whether `bytes` more would be granted now.
    pub fn has_room(&self, bytes: u64) -> bool {
        self.in_use().checked_add(bytes).is_some_and(|sum| sum <= self.budget())
    }

    /// An empty reservation, which can grow.
    pub fn empty(&self) -> Reservation {
        Reservation { memory: self.clone(), bytes: 0 }
    }

    /// Reserves `bytes` for `what`, a name that appears in the error.
    ///
    /// # Errors
    /// [`OutOfMemory`] with all figures. Nothing is reserved then.
    pub fn reserve(&self, what: &str, bytes: u64) -> Result<Reservation, OutOfMemory> {
        let mut reservation = self.empty();
        reservation.grow(what, bytes)?;
        Ok(reservation)
    }
}

impl Default for Reservation {
    /// An empty reservation of an unlimited budget.
    fn default() -> Self {
        HostMemory::unlimited().empty()
    }
}

impl Reservation {
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Makes another reservation of `bytes` in the same budget.
    ///
    /// # Errors
    /// [`OutOfMemory`].
    pub fn beside(&self, what: &str, bytes: u64) -> Result<Reservation, OutOfMemory> {
        self.memory.reserve(what, bytes)
    }

    /// Reserves `extra` more bytes.
    ///
    /// # Errors
    /// [`OutOfMemory`]. The reservation is then unchanged.
    pub fn grow(&mut self, what: &str, extra: u64) -> Result<(), OutOfMemory> {
        let Ledger { budget, in_use } = &*self.memory.0;
        let add = |used: u64| used.checked_add(extra).filter(|sum| sum <= budget);
        match in_use.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add) {
            Ok(_) => {
                self.bytes += extra;
                Ok(())
            }
            Err(used) => Err(OutOfMemory {
                what: what.to_owned(),
                needed: self.bytes.saturating_add(extra),
                in_use: used.saturating_sub(self.bytes),
                budget: *budget,
            }),
        }
    }

    /// Releases all but `bytes`.
    pub fn shrink_to(&mut self, bytes: u64) {
        let surplus = self.bytes.saturating_sub(bytes);
        self.bytes -= surplus;
        self.memory.0.in_use.fetch_sub(surplus, Ordering::Relaxed);
    }

    /// Splits off `bytes`, or everything if there are fewer.
    #[must_use]
    pub fn split(&mut self, bytes: u64) -> Reservation {
        let bytes = bytes.min(self.bytes);
        self.bytes -= bytes;
        Reservation { memory: self.memory.clone(), bytes }
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

/// The share of the budget that one load holds, and whether the load is still wanted. Clones share both.
#[derive(Clone, Debug)]
pub struct Admission(Arc<Admitted>);

#[derive(Debug)]
struct Admitted {
    is_cancelled: AtomicBool,
    held: Mutex<Reservation>,
}

impl Default for Admission {
    /// An admission without a budget.
    fn default() -> Self {
        Admission::new(&HostMemory::unlimited())
    }
}

impl Admission {
    pub fn new(memory: &HostMemory) -> Admission {
        let held = Mutex::new(memory.empty());
        Admission(Arc::new(Admitted { is_cancelled: AtomicBool::new(false), held }))
    }

    /// Makes the load end at its next step.
    pub fn cancel(&self) {
        self.0.is_cancelled.store(true, Ordering::Relaxed);
    }

    pub fn is_cancelled(&self) -> bool {
        self.0.is_cancelled.load(Ordering::Relaxed)
    }

    /// Checks whether the load was cancelled.
    ///
    /// # Errors
    /// [`Interrupt::Cancelled`].
    pub fn check(&self) -> Result<(), Interrupt> {
        if self.is_cancelled() { Err(Interrupt::Cancelled) } else { Ok(()) }
    }

    /// Reserves `bytes` more for `what`, before they are allocated.
    ///
    /// # Errors
    /// [`Interrupt`]. The reservation is then unchanged.
    pub fn grow(&self, what: &str, bytes: u64) -> Result<(), Interrupt> {
        self.check()?;
        Ok(self.0.held.lock().grow(what, bytes)?)
    }

    pub fn held(&self) -> u64 {
        self.0.held.lock().bytes()
    }

    /// Releases all but `bytes`.
    pub fn shrink_to(&self, bytes: u64) {
        self.0.held.lock().shrink_to(bytes);
    }

    /// Splits off the bytes that outlive the load.
    #[must_use]
    pub fn keep(&self, bytes: u64) -> Reservation {
        self.0.held.lock().split(bytes)
    }

    /// A meter for something that grows while it is being read.
    pub fn meter<'a>(&'a self, what: &'a str) -> Meter<'a> {
        Meter { admission: self, what, granted: 0, reserved: 0 }
    }
}

/// Grows a load's reservation in steps, as content outgrows what was granted.
#[derive(Debug)]
pub struct Meter<'a> {
    admission: &'a Admission,
    what: &'a str,
    granted: u64,
    /// Content up to this many bytes is covered by an exact reservation.
    reserved: u64,
}

/// Smallest step in which a [`Meter`] grows.
const STEP: u64 = 4 << 20;

impl Meter<'_> {
    /// Makes sure that exactly `bytes` in total are granted, for vectors that are reserved at once. Content of up to `bytes` then
    /// needs no more.
    ///
    /// # Errors
    /// [`Interrupt`].
    pub fn reach_exactly(&mut self, bytes: u64) -> Result<(), Interrupt> {
        if bytes > self.granted {
            self.admission.grow(self.what, bytes - self.granted)?;
            self.granted = bytes;
        }
        self.reserved = self.reserved.max(bytes);
        Ok(())
    }

    /// Makes sure that vectors may grow to `bytes` of content in total. A vector that doubles occupies up to three times its
    /// content while it copies itself to a new place. This much is granted, and a step more.
    ///
    /// # Errors
    /// [`Interrupt`].
    #[inline]
    pub fn reach(&mut self, bytes: u64) -> Result<(), Interrupt> {
        let needed = bytes.saturating_mul(3);
        if bytes <= self.reserved || needed <= self.granted {
            return Ok(());
        }
        let ahead = needed.saturating_add((needed / 8).max(STEP));
        self.admission.grow(self.what, ahead - self.granted)?;
        self.granted = ahead;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reservation_is_given_back_when_it_is_dropped() {
        let memory = HostMemory::new(100);
        let mut a = memory.reserve("a", 60).unwrap();
        assert_eq!(memory.in_use(), 60);
        let refused = memory.reserve("b", 50).unwrap_err();
        let expected = OutOfMemory { what: "b".into(), needed: 50, in_use: 60, budget: 100 };
        assert_eq!(refused, expected);
        assert!(!refused.is_hopeless());
        assert!(memory.reserve("c", 101).unwrap_err().is_hopeless());
        assert_eq!(memory.in_use(), 60);
        a.grow("a", 40).unwrap();
        // A holder that has the whole budget and wants more can never succeed.
        assert!(a.grow("a", 1).unwrap_err().is_hopeless());
        a.shrink_to(30);
        let kept = a.split(10);
        drop(a);
        assert_eq!((memory.in_use(), kept.bytes()), (10, 10));
        drop(kept);
        assert_eq!(memory.in_use(), 0);
        assert!(memory.reserve("overflow", u64::MAX).unwrap_err().is_hopeless());
    }

    #[test]
    fn an_admission_grows_until_it_is_cancelled() {
        let memory = HostMemory::new(64 << 20);
        let admission = Admission::new(&memory);
        let mut meter = admission.meter("points");
        meter.reach_exactly(1 << 20).unwrap();
        meter.reach(1 << 20).unwrap();
        assert_eq!(admission.held(), 1 << 20, "all of it has its place");
        meter.reach(2 << 20).unwrap();
        assert_eq!(admission.held(), 10 << 20, "an old copy, a new one of twice its size, a step");
        meter.reach(3 << 20).unwrap();
        assert_eq!(admission.held(), 10 << 20, "granted ahead");
        assert!(matches!(meter.reach(60 << 20), Err(Interrupt::OutOfMemory(_))));
        let kept = admission.keep(1 << 20);
        admission.cancel();
        assert_eq!(meter.reach(60 << 20), Err(Interrupt::Cancelled));
        drop(admission);
        assert_eq!(memory.in_use(), kept.bytes());
    }

    #[test]
    fn threads_never_reserve_more_than_the_budget() {
        let memory = HostMemory::new(1000);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for bytes in 0..1000 {
                        let held = memory.reserve("x", bytes);
                        assert!(memory.in_use() <= 1000);
                        drop(held);
                    }
                });
            }
        });
        assert_eq!(memory.in_use(), 0);
    }
}
