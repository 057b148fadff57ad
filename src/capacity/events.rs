//! Events of a simulation, in order of their times.

use std::collections::BTreeMap;

/// Future events. Events of the same time come in the order in which they were added, so that a simulation is the same on every machine.
#[derive(Debug)]
pub struct Events<E> {
    /// Events by time and number.
    queue: BTreeMap<(u64, u64), E>,
    added: u64,
    now_ns: u64,
}

impl<E> Default for Events<E> {
    fn default() -> Self {
        Self { queue: BTreeMap::new(), added: 0, now_ns: 0 }
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
        self.queue.insert((at_ns.max(self.now_ns), self.added), event);
    }

    /// Returns the time of the next event.
    pub fn next_ns(&self) -> Option<u64> {
        self.queue.first_key_value().map(|(&(at_ns, _), _)| at_ns)
    }

    /// Moves the clock to the next event, and returns it.
    pub fn pop(&mut self) -> Option<E> {
        let ((at_ns, _), event) = self.queue.pop_first()?;
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
