//! The broker: a work queue of runs in order of arrival, and messages that may get lost.

use std::collections::{BTreeMap, VecDeque};

use super::{Event, Message, Name, Publisher, World};
use crate::capacity::costs::BrokerCosts;
use crate::capacity::station::Station;
use crate::farm::pacing::ACK_WAIT;

/// A run that a worker has.
#[derive(Debug)]
struct Unacked {
    message: Message,
    heard_ns: u64,
}

#[derive(Debug)]
pub struct Broker {
    costs: BrokerCosts,
    station: Station,
    closed_until_ns: u64,
    pending: VecDeque<Message>,
    /// Runs that workers have, by the numbers of their deliveries.
    unacked: BTreeMap<u64, Unacked>,
    deliveries: u64,
    pulls: VecDeque<Name>,
}

impl Broker {
    pub fn new(costs: BrokerCosts) -> Broker {
        Broker {
            costs,
            station: Station::new(1),
            closed_until_ns: 0,
            pending: VecDeque::new(),
            unacked: BTreeMap::new(),
            deliveries: 0,
            pulls: VecDeque::new(),
        }
    }

    /// Serves a message that needs an answer, and returns when the answer is there.
    fn serve(&mut self, now_ns: u64, work_ns: u64) -> u64 {
        self.station.serve(now_ns, work_ns) + self.costs.trip_ns
    }

    fn bytes_ns(&self, bytes: u64) -> u64 {
        self.costs.kib_ns * bytes / 1024
    }

    /// Serves a message without an answer. `None`: it is lost, because the broker is restarting.
    pub fn tell(&mut self, now_ns: u64) -> Option<u64> {
        if now_ns < self.closed_until_ns {
            return None;
        }
        Some(self.serve(now_ns, self.costs.note_ns))
    }

    /// Takes a worker's word that it draws.
    pub fn progress(&mut self, now_ns: u64) -> u64 {
        self.serve(now_ns, self.costs.progress_ns)
    }

    /// Takes the acknowledgement of a run.
    pub fn acknowledge(&mut self, now_ns: u64) -> u64 {
        self.serve(now_ns, self.costs.pull_and_ack_ns / 3)
    }

    pub fn pull(&mut self, name: Name, now_ns: u64) {
        self.serve(now_ns, self.costs.pull_and_ack_ns / 3);
        self.pulls.push_back(name);
    }

    pub fn forget(&mut self, name: Name) {
        self.pulls.retain(|other| *other != name);
    }

    pub fn store(&mut self, message: Message) {
        self.pending.push_back(message);
    }

    /// Returns the run of a delivery; `None` if it has been acknowledged or delivered again.
    pub fn delivered(&self, number: u64) -> Option<&Message> {
        self.unacked.get(&number).map(|unacked| &unacked.message)
    }

    pub fn renew(&mut self, number: u64, now_ns: u64) {
        if let Some(unacked) = self.unacked.get_mut(&number) {
            unacked.heard_ns = now_ns;
        }
    }

    pub fn end(&mut self, number: u64) {
        self.unacked.remove(&number);
    }

    /// Ends the broker, which is there again at `until_ns` with all its runs. Workers then pull anew, because their pulls were lost; here
    /// the pulls wait.
    pub fn close(&mut self, until_ns: u64) {
        self.closed_until_ns = until_ns;
        self.station.close(until_ns);
        // The server does not know how long it was away: it waits for acknowledgements anew.
        for unacked in self.unacked.values_mut() {
            unacked.heard_ns = unacked.heard_ns.max(until_ns);
        }
    }

    pub fn busy_ns(&self, now_ns: u64) -> u64 {
        self.station.busy_ns(now_ns)
    }

    pub fn messages(&self) -> u64 {
        self.station.served()
    }
}

impl World {
    /// Sends a run to the broker.
    pub fn publish(&mut self, message: Message, publisher: Publisher) {
        let now_ns = self.now_ns();
        let work_ns = self.broker.costs.publish_ns + self.broker.bytes_ns(message.bytes);
        let done_ns = self.broker.serve(now_ns, work_ns);
        self.events.add(done_ns, Event::Published(message, publisher));
    }

    /// Delivers runs to workers that have pulled.
    pub fn deliver(&mut self) {
        let now_ns = self.now_ns();
        let broker = &mut self.broker;
        while !broker.pulls.is_empty() {
            let Some(message) = broker.pending.pop_front() else { break };
            let Some(to) = broker.pulls.pop_front() else { break };
            let work_ns = broker.costs.pull_and_ack_ns / 3 + broker.bytes_ns(message.bytes);
            let number = broker.deliveries;
            broker.deliveries += 1;
            let at_ns = broker.serve(now_ns, work_ns);
            broker.unacked.insert(number, Unacked { message, heard_ns: at_ns });
            self.events.add(at_ns, Event::Delivered { to, number });
            let wait_ns = ACK_WAIT.as_nanos() as u64;
            self.events.add(at_ns + wait_ns, Event::AckDue { number });
        }
    }

    /// Delivers a run again if nothing was heard of it.
    pub fn ack_due(&mut self, number: u64) {
        let now_ns = self.now_ns();
        let Some(unacked) = self.broker.unacked.get(&number) else { return };
        let due_ns = unacked.heard_ns + ACK_WAIT.as_nanos() as u64;
        if due_ns > now_ns {
            self.events.add(due_ns, Event::AckDue { number });
        } else if let Some(unacked) = self.broker.unacked.remove(&number) {
            self.outcome.redelivered += 1;
            self.broker.pending.push_front(unacked.message);
            self.deliver();
        }
    }
}
