//! Whether shadow maps may be used, which is known once they have landed. Pure.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::Mutex;

/// Whether a list was too short for maps, or for maps that they were copied from.
///
/// Frames copy maps that are still being drawn. Maps in flight are therefore asked for what is known of their origins by now: otherwise
/// frames that are drawn again, because their maps were spoiled, would copy those of the next frame in flight, which copied the spoiled
/// ones, and so on without end.
#[derive(Default)]
pub struct Soundness {
    is_spoiled: AtomicBool,
    /// Those of the maps that were copied, until the copy has landed.
    origins: Mutex<Vec<Arc<Soundness>>>,
}

impl Soundness {
    pub fn of_copy(origins: Vec<Arc<Soundness>>) -> Soundness {
        Soundness { origins: Mutex::new(origins), ..Soundness::default() }
    }

    pub fn is_spoiled(&self) -> bool {
        self.is_spoiled.load(Ordering::Relaxed)
            || self.origins.lock().iter().any(|origin| origin.is_spoiled())
    }

    /// No frame may use the maps.
    pub fn spoil(&self) {
        self.is_spoiled.store(true, Ordering::Relaxed);
        self.origins.lock().clear();
    }

    /// The maps have landed and are sound.
    pub fn settle(&self) {
        self.origins.lock().clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn copy_of(origin: &Arc<Soundness>) -> Arc<Soundness> {
        Arc::new(Soundness::of_copy(vec![origin.clone()]))
    }

    #[test]
    fn copies_in_flight_are_as_sound_as_their_origins() {
        let first = Arc::new(Soundness::default());
        let second = copy_of(&first);
        let third = copy_of(&second);
        assert!(!third.is_spoiled());
        // The first lands. A frame that is drawn now may not copy the third, although the second has not landed.
        first.spoil();
        assert!(second.is_spoiled() && third.is_spoiled());
        second.spoil();
        assert!(third.is_spoiled());
    }

    #[test]
    fn maps_that_have_landed_forget_their_origins() {
        let first = Arc::new(Soundness::default());
        let second = copy_of(&first);
        second.settle();
        assert_eq!(Arc::strong_count(&first), 1);
        first.spoil();
        assert!(!second.is_spoiled(), "it was copied while the first was sound");
    }
}
