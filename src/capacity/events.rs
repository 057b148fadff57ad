//! Events of a simulation, in order of their times.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Future events. Events of the same time come in the order in which they were added, so that a simulation is the same on every machine.
#[derive(Debug)]
pub struct Events<E> {
    heap: BinaryHeap<Entry<E>>,
    added: u64,
    now_ns: u64,
}

#[derive(Debug)]
struct Entry<E> {
    at_ns: u64,
    number: u64,
    event: E,
}

impl<E> Entry<E> {
    /// The largest entry of the heap is the next event.
    fn order(&self) -> (std::cmp::Reverse<u64>, std::cmp::Reverse<u64>) {
        (std::cmp::Reverse(self.at_ns), std::cmp::Reverse(self.number))
    }
}

impl<E> PartialEq for Entry<E> {
    fn eq(&self, other: &Self) -> bool {
        self.order() == other.order()
    }
}

impl<E> Eq for Entry<E> {}

impl<E> PartialOrd for Entry<E> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<E> Ord for Entry<E> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.order().cmp(&other.order())
    }
}

impl<E> Default for Events<E> {
    fn default() -> Self {
        Self { heap: BinaryHeap::new(), added: 0, now_ns: 0 }
    }
}

impl<E> Events<E> {
    /// Returns the time of the latest event.
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// Adds an event. A time in the past means now.
    pub fn add(&mut self, at_ns: u64, event: E) {
        self.added += 1;
        self.heap.push(Entry { at_ns: at_ns.max(self.now_ns), number: self.added, event });
    }

    /// Returns the time of the next event.
    pub fn next_ns(&self) -> Option<u64> {
        self.heap.peek().map(|entry| entry.at_ns)
    }

    /// Moves the clock to the next event, and returns it.
    pub fn pop(&mut self) -> Option<E> {
        let Entry { at_ns, event, .. } = self.heap.pop()?;
        self.now_ns = at_ns;
        Some(event)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_come_in_order_of_time_and_then_as_they_were_added() {
        let mut events = Events::default();
        for (at, name) in [(5, 'c'), (1, 'a'), (5, 'd'), (3, 'b')] {
            events.add(at, name);
        }
        let mut order = String::new();
        while let Some(name) = events.pop() {
            order.push(name);
            if name == 'c' {
                events.add(2, 'e');
                assert_eq!(events.next_ns(), Some(5));
            }
        }
        assert_eq!((order.as_str(), events.now_ns()), ("abcde", 5));
    }
}
